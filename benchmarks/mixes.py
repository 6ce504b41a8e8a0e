"""The benchmarks by the name of their mix of cases, and what each of them has to do for a campaign."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Protocol

import pandas as pd
from concealed.benchmark import Concealed
from injected.benchmark import Injected
from whole_car.benchmark import WholeCars
from whole_car.cars import OWN


class Benchmark(Protocol):
    """What a campaign asks of a benchmark; `simpler` are methods whose scores are kept beside those of a diagnosis."""

    @property
    def simpler(self) -> Sequence[str]: ...

    def build(self, seed: int, index: int, folder: Path) -> None:
        """Case `index` under folder/cases and its truth under folder/sealed, unless they stand there."""
        ...

    def prepare(self, case: Path, sealed: Path, *, baselines: bool) -> None:
        """What else is known of a case once it is built: an oracle, and simpler methods where they are asked for."""
        ...

    def asked(self, case: Path) -> Sequence[Path]:
        """The folders of a case that are diagnosed."""
        ...

    def judged(
        self, folder: Path, built: Sequence[int], diagnoses: Sequence[str], command: str, where: str
    ) -> tuple[pd.DataFrame, str]:
        """A row per case, and the page."""
        ...

    def kept(self, folder: Path, built: Sequence[int], diagnosis: str) -> Mapping[int, str]:
        """The scores of each case that a diagnosis has answered as a line of JSON, if this benchmark can do with
        them."""
        ...


BENCHMARKS: Mapping[str, Benchmark] = {
    "concealed": Concealed("concealed"),
    "nothing": Concealed("nothing"),
    "whole_car": WholeCars(),
    "own_model": WholeCars({OWN: 1.0}),
    "injected": Injected(),
}
