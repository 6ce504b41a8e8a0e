"""A diagnosis from recordings to what a user takes away: verdict.json, extended.yaml, pictures, one page."""

import json
import logging
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import pandas as pd
from tqdm import tqdm

from vehicle_sbi.files import write_text
from vehicle_sbi.mismatch.answer.schema import Verdict, listed
from vehicle_sbi.mismatch.answer.verdict import Found, verdict
from vehicle_sbi.mismatch.estimation.estimate import quantity
from vehicle_sbi.mismatch.hypotheses.block import spoken
from vehicle_sbi.mismatch.pipeline import STEPS, steps
from vehicle_sbi.mismatch.problem.case import Case
from vehicle_sbi.report.card import LEGEND, could_show, hidden
from vehicle_sbi.report.extended import extended
from vehicle_sbi.report.mismatch_figures import held_out_figure, probabilities, residuals, shifts
from vehicle_sbi.report.page import in_section, write_page
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.stage_file import StageFileError, read
from vehicle_sbi.report.stage_file import write as write_stage
from vehicle_sbi.report.tables import html
from vehicle_sbi.rng import Stream, generator
from vehicle_sbi.rounding import mean_and_std

LISTED = 0.05  # probability from which an effect is listed on the page
SETS = 8  # of effects that are listed there
Result = TypeVar("Result")

_log = logging.getLogger(__name__)

if TYPE_CHECKING:  # it needs sbi, which takes seconds to import
    from vehicle_sbi.mismatch.selection.reinfer import Reinference


def diagnose(folder: RunFolder, case: Case, again: "Reinference | None" = None, *, seed: int, figures: bool) -> None:
    """All steps, each kept on disk once it is done, then everything that is written for the user; `again` says how the
    extended model is to be inferred, if it is."""
    infer = None if again is None else lambda model: again.inferred(model, folder.path / "rounds")
    with tqdm(total=len(STEPS), bar_format="{desc:<24}|{bar:20}| {elapsed}{postfix}", disable=None) as bar:

        def kept(name: str, kind: type[Result], compute: Callable[[], Result]) -> Result:
            return _kept(folder, name, kind, compute, bar)

        found = steps(case, rng=generator(seed=seed, stream=Stream.STUDY, index=2), keep=kept, infer=infer)
    with folder.stage("report"):
        answer = verdict(case, found)
        write(folder, found, answer)
        if figures:
            write_report(folder, case, found, answer)
    folder.complete()


def _kept(folder: RunFolder, name: str, kind: type[Result], compute: Callable[[], Result], bar: tqdm) -> Result:
    """A step's result, from its file where the step is done."""
    path = folder.path / "stages" / f"{name}.npz"
    bar.set_description_str(STEPS[name])
    if (result := _done(path, kind)) is None:
        with folder.stage(name):
            result = compute()
        write_stage(path, result, kind)
        result = read(path, kind)  # what goes on from here has nothing but what another start would have
    bar.update()
    return result


def _done(path: Path, kind: type[Result]) -> Result | None:
    """What a stage's file holds; None where there is none, or none of this version."""
    if not path.exists():
        return None
    try:
        return read(path, kind)
    except StageFileError as error:
        _log.warning("%s; the stage is done anew", error)
        return None


def write(folder: RunFolder, found: Found, answer: Verdict) -> None:
    """The answer and the extended model."""
    write_text(folder.path / "verdict.json", json.dumps(answer.as_json(), indent=2) + "\n")
    write_text(folder.path / "extended.yaml", extended(found.extended.model, folder.config))


def write_report(folder: RunFolder, case: Case, found: Found, answer: Verdict) -> None:
    """Pictures and the page."""
    path = folder.path
    figures = path / "figures"
    figures.mkdir(exist_ok=True)
    pictures = {
        "Recorded less simulated, before and after; shaded where the base model misses": figures / "residuals.png",
        "Probability that each effect is missing, whatever else is": figures / "probabilities.png",
        "The base model's parameters before, and with what is missing averaged over": figures / "shifts.png",
    }
    residuals(found, answer, figures / "residuals.png")
    probabilities(answer, figures / "probabilities.png")
    shifts(answer, found.examined.fit.simulator.space, figures / "shifts.png")
    if found.predictions:
        pictures["Held-out recordings, predicted by both models"] = figures / "held_out.png"
        held_out_figure(case.held_out, found.predictions, figures / "held_out.png")
    write_page(
        path / "report.html",
        title=f"Diagnosis of {case.name}",
        sections={
            "Answer": f"<p><strong>{escape(answer.headline)}</strong></p>{_paragraphs(answer.lines)}",
            "What is missing": in_section(html(_effects(answer)), LEGEND_OF_EFFECTS),
            "Together": in_section(html(_sets(answer)), LEGEND_OF_SETS),
            "What is left over": in_section(html(_laws(answer)), LEGEND_OF_LAWS)
            if answer.unknown
            else "<p>Nothing beyond noise.</p>",
            "Base parameters": in_section(html(_base(answer))),
            "Where": in_section(html(_places(answer))) if answer.mismatch else "<p>Nowhere beyond noise.</p>",
            "Held out": in_section(html(_scores(answer))) + _accepted(answer),
            "What these recordings could have shown": in_section(html(could_show(found.seen)), LEGEND)
            + _paragraphs(hidden(found.seen)),
        },
        warnings=answer.warnings,
        notes=[note for note in answer.notes if note not in answer.warnings],
        figures=pictures,
    )


LEGEND_OF_EFFECTS = (
    "Probability that an effect is missing, whatever else is; sizes where it is missing. Any number of effects may be "
    "missing at once, beside discrepancies that no effect stands for."
)
LEGEND_OF_SETS = (
    "Probability that exactly these effects are missing: nothing else, or nothing but a discrepancy that no effect "
    "stands for. The first set is the extended model."
)
LEGEND_OF_LAWS = (
    "Loads and errors that no effect stands for: root mean square, and the signal of the drive that they follow best, "
    "with the share of their course that it explains."
)


def _paragraphs(lines: Sequence[str]) -> str:
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def _effects(answer: Verdict) -> pd.DataFrame:
    sizes = {name: e for one in reversed(answer.explanations) for name, e in one.sizes.items()}
    sizes |= {name: e for one in answer.unsupported for name, e in one.parameters.items() if name not in sizes}
    rows = [
        {
            "effect": name,
            "probability": f"{p:.2f}",
            "size": "; ".join(quantity(key, e) for key, e in sizes.items() if key.split(".")[0] == name),
        }
        for name, p in answer.effects.items()
        if p >= LISTED
    ]
    return pd.DataFrame(rows, columns=["effect", "probability", "size"])


def _sets(answer: Verdict) -> pd.DataFrame:
    """The likeliest sets, none, and what is left over by itself."""
    rows = [
        {
            "effects": listed(one.effects),
            "alone": f"{one.probability:.3f}",
            "with a discrepancy": f"{one.beside_unknown:.3f}",
        }
        for one in answer.explanations[:SETS]
    ]
    rows.append({"effects": "none", "alone": f"{answer.p_none:.3f}", "with a discrepancy": ""})
    return pd.DataFrame(rows)


def _laws(answer: Verdict) -> pd.DataFrame:
    laws = answer.unknown.laws if answer.unknown else []
    return pd.DataFrame(
        {
            "what": [law.target for law in laws],
            "root mean square": [quantity("", law.size).removeprefix(" = ") for law in laws],
            "follows": [f"{law.signal} ({law.share:.0%})" for law in laws],
        }
    )


def _base(answer: Verdict) -> pd.DataFrame:
    """Base parameters by the base model, and with all that may be missing averaged over."""
    rows = list[dict[str, str]]()
    for name, one in answer.base_parameters.items():
        values: Any = one
        rows.append(
            {
                "parameter": name,
                "unit": values["unit"],
                "base model": mean_and_std(values["before"]["mean"], values["before"]["std"]),
                "whatever is missing": mean_and_std(values["after"]["mean"], values["after"]["std"]),
                "90 %": f"{values['after']['q05']:.4g} to {values['after']['q95']:.4g}",
            }
        )
    return pd.DataFrame(rows)


def _places(answer: Verdict) -> pd.DataFrame:
    return pd.DataFrame(
        {
            "channel": [p.channel for p in answer.mismatch],
            "when": [spoken(p.within) for p in answer.mismatch],
            "regime": [p.regime or "any" for p in answer.mismatch],
            "p": [f"{p.p_value:.2g}" for p in answer.mismatch],
            "share": [f"{p.share_of_misfit:.0%}" for p in answer.mismatch],
        }
    )


def _scores(answer: Verdict) -> pd.DataFrame:
    rows = []
    for name in ("base", "extended"):
        score: Any = answer.fit.get(name)
        if score is not None:
            errors = {f"NRMSE {channel}": f"{value:.3f}" for channel, value in score["nrmse"].items()}
            errors |= {f"CRPS {channel}": f"{value:.3g}" for channel, value in score["crps"].items()}
            rows.append(
                {
                    "model": name,
                    **errors,
                    "log score": f"{score['log_score']:.3f}",
                    "in 90 % band": f"{score['coverage90']:.0%}",
                }
            )
    return pd.DataFrame(rows)


def _accepted(answer: Verdict) -> str:
    """Whether the extended model is accepted, and why."""
    if "accepted" not in answer.fit:
        return ""
    said = "accepted" if answer.fit["accepted"] else "not accepted"
    return _paragraphs([f"The extended model is {said}: {answer.fit['accepted_because']}."])


def show(folder: RunFolder) -> None:
    """Print the headline of a finished diagnosis, its lines and warnings, and the paths of what it wrote."""
    answer = json.loads((folder.path / "verdict.json").read_text())
    print(answer["headline"], *answer["lines"], *answer["warnings"], sep="\n")
    print()
    for name in ("verdict.json", "extended.yaml", "report.html"):
        if (folder.path / name).exists():
            print(folder.path / name)
