"""Whole cars, four to nine things missing at once: what a campaign asks of this benchmark."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import pandas as pd
from concealed.baselines import write as write_baselines
from measures import by_all
from score_files import SUFFIX, called, lines_of

from whole_car import cases, oracle, page
from whole_car.cars import WORLDS
from whole_car.scores import SIMPLER, Scored, as_line, from_line, scored


@dataclass(frozen=True)
class WholeCars:
    """Cars of which much is missing, judged by their parameters and by the names, in these worlds."""

    worlds: Mapping[str, float] = field(default_factory=lambda: WORLDS)
    simpler: Sequence[str] = tuple(SIMPLER)

    def build(self, seed: int, index: int, folder: Path) -> None:
        cases.build(seed, index, folder, self.worlds)

    def prepare(self, case: Path, sealed: Path, *, baselines: bool) -> None:
        oracle.write(case, sealed)
        if baselines:
            write_baselines(case, tested=False)  # that something is missing is known

    def asked(self, case: Path) -> Sequence[Path]:
        return (case,)

    def judged(
        self, folder: Path, built: Sequence[int], diagnoses: Sequence[str], command: str, where: str
    ) -> tuple[pd.DataFrame, str]:
        """Columns are the diagnoses, and simpler methods where they were asked, over the cases that all diagnoses have
        answered."""
        found = {called(name): _every(folder, built, name) for name in diagnoses}
        found = {name: one for name, one in found.items() if one or name not in SIMPLER}
        answered, unanswered = by_all({name: one for name, one in found.items() if name not in SIMPLER}, built)
        columns = {SIMPLER.get(name, name): [one[i] for i in answered if i in one] for name, one in found.items()}
        return page.table(next(iter(columns.values()))), page.report(columns, unanswered, command, where)

    def kept(self, folder: Path, built: Sequence[int], diagnosis: str) -> Mapping[int, str]:
        return {i: as_line(one) for i, one in _every(folder, built, diagnosis).items()}


def _every(folder: Path, cases: Sequence[int], name: str) -> dict[int, Scored]:
    """The cases that are answered, by number; from a file of scores where the name is one's."""
    if name.endswith(SUFFIX):
        return {i: from_line(line) for i, line in lines_of(Path(name)).items()}
    return {i: one for i in cases if (one := scored(folder, i, name)) is not None}
