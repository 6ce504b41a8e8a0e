"""One thing missing, concealed in simulation or in real recordings: what a campaign asks of this benchmark."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd

from concealed import baselines as simpler
from concealed import cases, injected, observer, oracle, scores, summary
from vehicle_sbi.physics.effects import CATALOGUE


@dataclass(frozen=True)
class Concealed:
    """A mix of cases of one thing missing, or two, or nothing."""

    mix: str
    simpler: Sequence[str] = ()

    def build(self, seed: int, index: int, folder: Path) -> None:
        cases.build(seed, index, self.mix, folder, injected.build, list(injected.INJECTED))

    def prepare(self, case: Path, sealed: Path, *, baselines: bool) -> None:
        oracle.write(case, sealed)
        if baselines:
            simpler.write(case)
            observer.write(case, sealed)

    def asked(self, case: Path) -> Sequence[Path]:
        return (case,)

    def judged(
        self, folder: Path, built: Sequence[int], diagnoses: Sequence[str], command: str, where: str
    ) -> tuple[pd.DataFrame, str]:
        table = gather(folder, built, diagnoses[0])
        return table, summary.report(table, command, where, len(CATALOGUE))

    def kept(self, folder: Path, built: Sequence[int], diagnosis: str) -> Mapping[int, str]:
        return {}


def gather(folder: Path, built: Sequence[int], diagnosis: str = "diagnosis") -> pd.DataFrame:
    """A row for each case that is built."""
    return pd.DataFrame([scores.row(folder, i, diagnosis) for i in built])
