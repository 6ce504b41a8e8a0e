"""Whole cars, four to nine things missing at once: what a campaign asks of this benchmark."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import pandas as pd
from concealed import baselines as simpler

from whole_car import cases, oracle, page
from whole_car.scores import CHOOSING, Scored, scored
from whole_car.scores import simpler as by_simpler


@dataclass(frozen=True)
class WholeCars:
    """Cars of which much is missing, judged by their parameters and by the names."""

    def build(self, seed: int, index: int, folder: Path) -> None:
        cases.build(seed, index, folder)

    def prepare(self, case: Path, sealed: Path, *, baselines: bool) -> None:
        oracle.write(case, sealed)
        if baselines:
            simpler.write(case)

    def asked(self, case: Path) -> Sequence[Path]:
        return (case,)

    def judged(
        self, folder: Path, built: Sequence[int], diagnoses: Sequence[str], command: str, where: str
    ) -> tuple[pd.DataFrame, str]:
        """Columns are the diagnoses and simpler methods, each over the cases that all diagnoses have answered."""
        answered = [i for i in built if all(scored(folder, i, name) for name in diagnoses)]
        columns = {name: _every(scored, folder, answered, name) for name in diagnoses}
        columns |= {name: found for name in CHOOSING if (found := _every(by_simpler, folder, answered, name))}
        return page.table(columns[diagnoses[0]]), page.report(columns, command, where)


def _every(
    judge: Callable[[Path, int, str], Scored | None], folder: Path, cases: Sequence[int], name: str
) -> list[Scored]:
    return [one for i in cases if (one := judge(folder, i, name)) is not None]
