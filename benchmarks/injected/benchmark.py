"""Effects injected into real recordings: what a campaign asks of this benchmark."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from measures import by_all

from injected import cases, page
from injected.cases import HALVES
from injected.scores import difference


@dataclass(frozen=True)
class Injected:
    """Stretches of real recordings, with and without an effect, judged by the difference."""

    simpler: Sequence[str] = ()

    def build(self, seed: int, index: int, folder: Path) -> None:
        cases.build(seed, index, folder)

    def prepare(self, case: Path, sealed: Path, *, baselines: bool) -> None:
        """Nothing more is known of them."""

    def asked(self, case: Path) -> Sequence[Path]:
        return [case / half for half in HALVES]

    def judged(
        self, folder: Path, built: Sequence[int], diagnoses: Sequence[str], command: str, where: str
    ) -> tuple[pd.DataFrame, str]:
        found = {name: {i: d for i in built if (d := difference(folder, i, name))} for name in diagnoses}
        answered, unanswered = by_all(found, built)
        columns = {name: [one[i] for i in answered] for name, one in found.items()}
        return page.table(columns[diagnoses[0]]), page.report(columns, unanswered, command, where)

    def kept(self, folder: Path, built: Sequence[int], diagnosis: str) -> Mapping[int, str]:
        return {}
