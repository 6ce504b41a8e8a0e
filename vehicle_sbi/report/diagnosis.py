"""A diagnosis from recordings to what a user takes away: verdict, extended model, draws, pictures, one page."""

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, TypeVar

from tqdm import tqdm

from vehicle_sbi.files import write_text
from vehicle_sbi.mismatch.answer.schema import Verdict
from vehicle_sbi.mismatch.answer.verdict import Found, verdict
from vehicle_sbi.mismatch.pipeline import STEPS, steps
from vehicle_sbi.mismatch.problem.case import Case
from vehicle_sbi.report import netcdf
from vehicle_sbi.report.extended import command, extended
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.stage_file import read
from vehicle_sbi.report.stage_file import write as write_stage
from vehicle_sbi.report.tables.base_parameters import terminal
from vehicle_sbi.rng import Stream, generator

Result = TypeVar("Result")
WRITTEN = ("verdict.json", "extended.yaml", netcdf.FILE, "report.html")  # for the user

if TYPE_CHECKING:  # it needs sbi, which takes seconds to import
    from vehicle_sbi.mismatch.selection.reinfer import Reinference


def diagnose(folder: RunFolder, case: Case, again: "Reinference | None" = None, *, seed: int, figures: bool) -> None:
    """All steps, each kept on disk once it is done, then everything that is written for the user; `again` says how the
    extended model is to be inferred, if it is."""
    infer = None if again is None else lambda model: again.inferred(model, folder.checkpoints)
    with tqdm(total=len(STEPS), bar_format="{desc:<24}|{bar:20}| {elapsed}{postfix}", disable=None) as bar:

        def kept(name: str, kind: type[Result], compute: Callable[[], Result]) -> Result:
            return _kept(folder, name, kind, compute, bar)

        found = steps(case, rng=generator(seed=seed, stream=Stream.STUDY, index=2), keep=kept, infer=infer)
    with folder.stage("report"):
        answer = verdict(case, found)
        write(folder, case, found, answer)
        if figures:
            write_report(folder, case, found, answer)
    folder.complete()


def _kept(folder: RunFolder, name: str, kind: type[Result], compute: Callable[[], Result], bar: tqdm) -> Result:
    """A step's result, from its file where the step is done."""
    file = f"stages/{name}.npz"
    bar.set_description_str(STEPS[name])
    if (path := folder.checkpoints.kept(file)) is None:
        with folder.stage(name):
            result = compute()
        path = folder.checkpoints.write(file, lambda opened: write_stage(opened, result, kind))
    bar.update()
    return read(path, kind)  # what goes on from here has nothing but what another start would have


def write(folder: RunFolder, case: Case, found: Found, answer: Verdict) -> None:
    """The answer, the extended model, and the draws where there are any."""
    write_text(folder.path / "verdict.json", json.dumps(answer.as_json(), indent=2) + "\n")
    write_text(folder.path / "extended.yaml", extended(found.extended.model, folder.config))
    if found.pruned is not None:
        origin = netcdf.Origin.of_folder(folder, case.name)
        netcdf.write(folder.path / netcdf.FILE, netcdf.of_diagnosis(case, found.pruned, origin))


def write_report(folder: RunFolder, case: Case, found: Found, answer: Verdict) -> None:
    """Pictures and the page."""
    from vehicle_sbi.report.mismatch_figures import held_out_figure, probabilities, residuals, shifts  # seconds
    from vehicle_sbi.report.page.diagnosis import page_of
    from vehicle_sbi.report.page.page import write_page

    figures = folder.path / "figures"
    figures.mkdir(exist_ok=True)
    residuals(found, answer, figures / "residuals.png")
    probabilities(answer, figures / "probabilities.png")
    shifts(answer, found.examined.fit.simulator.space, figures / "shifts.png")
    if found.predictions:
        held_out_figure(case.held_out, found.predictions, figures / "held_out.png")
    write_page(folder.path / "report.html", page_of(case, found, answer))


def show(folder: RunFolder) -> None:
    """Print the headline of a finished diagnosis, its lines, warnings and base parameters, the paths of what it wrote,
    and what infers the extended model."""
    answer = json.loads((folder.path / "verdict.json").read_text(encoding="utf-8"))
    print(answer["headline"], *answer["lines"], *answer["warnings"], sep="\n")
    print(f"\n{terminal(answer['base_parameters'])}\n")
    print(*(folder.path / name for name in WRITTEN if (folder.path / name).exists()), sep="\n")
    print(f"\nTo infer the extended model with networks, which is optional and slower:\n{command(folder.path)}")
