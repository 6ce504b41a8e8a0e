"""A diagnosis from recordings to what a user takes away: verdict.json, extended.yaml, pictures, one page."""

import json
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import pandas as pd
from tqdm import tqdm

from vehicle_sbi.files import write_text
from vehicle_sbi.inference.directions import Direction, left_out
from vehicle_sbi.mismatch.answer import Verdict, listed, quantity
from vehicle_sbi.mismatch.base_fit import fitted, refitted
from vehicle_sbi.mismatch.case import Case
from vehicle_sbi.mismatch.explain import explain
from vehicle_sbi.mismatch.explanation import Explanation
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.full_model import full_model
from vehicle_sbi.mismatch.gate import Gate, through
from vehicle_sbi.mismatch.improve import Gain, Prediction, gain, predict
from vehicle_sbi.mismatch.locate import spoken
from vehicle_sbi.mismatch.sampled import sized
from vehicle_sbi.mismatch.selection.expand_and_prune import MOST_READINGS, Pruned, expand_and_prune
from vehicle_sbi.mismatch.separability import Card, card
from vehicle_sbi.mismatch.verdict import chosen, verdict
from vehicle_sbi.report.card import LEGEND, could_show, hidden
from vehicle_sbi.report.extended import extended
from vehicle_sbi.report.mismatch_figures import held_out_figure, probabilities, residuals, shifts
from vehicle_sbi.report.page import in_section, write_page
from vehicle_sbi.report.run_folder import RunFolder
from vehicle_sbi.report.stage_file import StageFileError, read
from vehicle_sbi.report.stage_file import write as write_stage
from vehicle_sbi.report.tables import html
from vehicle_sbi.rng import Stream, generator

STAGES = {
    "fit": "fitting the base model",
    "directions": "what could be missing",
    "separability": "what could be seen",
    "explanation": "what is missing",
    "sizes": "how large it is",
    "posterior": "inferring it",
    "pruned": "every effect at once",
}
WHATEVER_ELSE = (
    "Probability that each effect is missing where any number of them may be, and discrepancies that no effect stands "
    "for. Base parameters after the diagnosis are averages over all of these."
)
LIKELY = 0.2  # probability from which an effect is listed there
Result = TypeVar("Result")

_log = logging.getLogger(__name__)

if TYPE_CHECKING:  # it needs sbi, which takes seconds to import
    from vehicle_sbi.mismatch.reinfer import Reinference


def diagnose(folder: RunFolder, case: Case, again: "Reinference | None" = None, *, seed: int, figures: bool) -> None:
    """All stages, each kept on disk once it is done, then everything that is written for the user; `again` says how the
    extended model is to be inferred, if it is."""
    starts, draws, sizes, sampled = (
        generator(seed=seed, stream=Stream.STUDY, index=k) for k in (2, 3, 4, 5)
    )  # a stage has its own
    stages = len(STAGES) - 1  # the last one is in place of the one before
    with tqdm(total=stages, bar_format="{desc:<24}|{bar:20}| {elapsed}{postfix}", disable=None) as bar:
        begun = _kept(folder, "fit", Begun, lambda: started(case, starts), bar)
        base, passed = begun.base, begun.gate
        known = _kept(folder, "directions", list[Direction], lambda: left_out(base.simulator, base.theta), bar)
        seen = _kept(folder, "separability", Card, lambda: card(base.simulator, base.theta, known), bar)
        showing = seen.visible(known)
        found = _kept(folder, "explanation", Explanation, lambda: explained(case, begun, showing, draws, bar), bar)
        searched, rounds = found, folder.path / "rounds"
        if again is None:
            found = _kept(folder, "sizes", Explanation, lambda: sized(searched, sizes).supported(), bar)
        else:
            found = _kept(folder, "posterior", Explanation, lambda: again.of(searched, rounds).supported(), bar)
        pruned = _kept(folder, "pruned", AtOnce, lambda: at_once(case, found, showing, sampled), bar).pruned
    with folder.stage("report"):
        predictions, gained = proved(case, found)
        answer = verdict(case, passed, found, predictions, gained, seen, pruned)
        write(folder, found, answer)
        if figures:
            write_report(folder, case, found, predictions, answer, seen)
    folder.complete()


@dataclass(frozen=True)
class Begun:
    """The base model's fit, how far it can be trusted, and the fit with everything that could be missing in."""

    base: Fit
    gate: Gate
    full: Fit | None


@dataclass(frozen=True)
class AtOnce:
    """What is found with every effect free at once, if that is asked and can be simulated."""

    pruned: Pruned | None


def at_once(case: Case, found: Explanation, known: Sequence[Direction], rng: np.random.Generator) -> AtOnce:
    """Expand and prune, where anything is missing and recordings are not too long for it."""
    base = found.base.model.fit
    if not found.detected or base.at.y.size > MOST_READINGS:
        return AtOnce(None)
    return AtOnce(expand_and_prune(base, known, case.naming, prior=case.effect_prior, rng=rng))


def started(case: Case, rng: np.random.Generator) -> Begun:
    """The base model's fit, started from many places, that of the full model among them."""
    base = fitted(case.observation, rng)
    full = full_model(base, left_out(base.simulator, base.theta))
    base, passed = through(refitted(base, full), rng)
    return Begun(base, passed, full)


def explained(case: Case, begun: Begun, known: Sequence[Direction], rng: np.random.Generator, bar: tqdm) -> Explanation:
    """What is missing, from the recordings that are fitted and those that help to name."""
    found = explain(begun.base, known, rng=rng, full=begun.full, belief=case.belief, tried=bar.set_postfix_str)
    return found if case.naming is None else found.foretelling(case.naming)


def proved(case: Case, found: Explanation) -> tuple[dict[str, Prediction], Gain | None]:
    """How base and extended model predict what was held out, if they can be simulated there, and what the latter
    gains."""
    models = {"base": found.base.model, "extended": chosen(found)}
    if models["extended"] is models["base"]:
        del models["extended"]
    tried = {name: predict(model, case.held_out, apart=case.apart) for name, model in models.items()}
    predictions = {name: prediction for name, prediction in tried.items() if prediction is not None}
    return predictions, gain(**predictions) if len(predictions) == 2 else None


def _kept(folder: RunFolder, name: str, kind: type[Result], compute: Callable[[], Result], bar: tqdm) -> Result:
    """A stage's result, from its file where the stage is done."""
    path = folder.path / "stages" / f"{name}.npz"
    bar.set_description_str(STAGES[name])
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


def write(folder: RunFolder, found: Explanation, answer: Verdict) -> None:
    """The answer and the extended model."""
    write_text(folder.path / "verdict.json", json.dumps(answer.as_json(), indent=2) + "\n")
    write_text(folder.path / "extended.yaml", extended(chosen(found), folder.config))


def write_report(
    folder: RunFolder, case: Case, found: Explanation, predictions: dict[str, Prediction], answer: Verdict, seen: Card
) -> None:
    """Pictures and the page."""
    path = folder.path
    figures = path / "figures"
    figures.mkdir(exist_ok=True)
    pictures = {
        "Recorded less simulated, before and after; shaded where the base model misses": figures / "residuals.png",
        "Probability of each explanation": figures / "probabilities.png",
        "The base model's parameters before and after": figures / "shifts.png",
    }
    residuals(found, answer, figures / "residuals.png")
    probabilities(answer, figures / "probabilities.png")
    shifts(answer, found.base.model.fit.simulator.space, figures / "shifts.png")
    if predictions:
        pictures["Held-out recordings, predicted by both models"] = figures / "held_out.png"
        held_out_figure(case.held_out, predictions, figures / "held_out.png")
    write_page(
        path / "report.html",
        title=f"Diagnosis of {case.name}",
        sections={
            "Answer": _paragraphs([line for line in (answer.sentence, answer.separating_experiment) if line]),
            "Explanations": in_section(html(_explanations(answer)) + _of_held_out(answer) + _set_aside(answer)),
            "With every effect free at once": in_section(html(_whatever_else(answer)), WHATEVER_ELSE)
            if answer.whatever_else
            else "<p>Not asked: nothing was detected, or the recordings are too long.</p>",
            "Where": in_section(html(_places(answer))) if answer.mismatch else "<p>Nowhere beyond noise.</p>",
            "Held out": in_section(html(_scores(answer))) + _accepted(answer),
            "What these recordings could have shown": in_section(html(could_show(seen)), LEGEND)
            + _paragraphs(hidden(seen)),
        },
        warnings=answer.warnings,
        notes=[note for note in answer.notes if note not in answer.warnings],
        figures=pictures,
    )


def _paragraphs(lines: Sequence[str]) -> str:
    return "".join(f"<p>{escape(line)}</p>" for line in lines)


def _explanations(answer: Verdict) -> pd.DataFrame:
    rows = [
        {
            "explanation": listed(one.effects),
            "probability": f"{one.probability:.3f}",
            "with something unknown": f"{one.beside_unknown:.3f}",
            "held out": "" if one.foretold is None else f"{one.foretold:+.1f}",
            "size": "; ".join([*(quantity(name, e) for name, e in one.sizes.items()), *one.acting]),
        }
        for one in answer.explanations
        if one.probability + one.beside_unknown >= 0.001
    ]
    rows += [
        {"explanation": "none", "probability": f"{answer.p_none:.3f}"},
        {"explanation": "unknown", "probability": f"{answer.p_unknown:.3f}"},
    ]
    columns = ["explanation", "probability", "with something unknown", "held out", "size"]
    table = pd.DataFrame(rows, columns=columns, dtype=object).fillna("")
    return table.loc[:, ["explanation", "probability", *(c for c in table.columns[2:] if table[c].any())]]


def _whatever_else(answer: Verdict) -> pd.DataFrame:
    """Effects that are at all likely where all of them may be missing at once."""
    likely = {name: p for name, p in answer.whatever_else.items() if p >= LIKELY}
    return pd.DataFrame({"effect": [*likely], "probability": [f"{p:.2f}" for p in likely.values()]})


def _of_held_out(answer: Verdict) -> str:
    """What the column of that name says, where it says anything."""
    told = any(one.foretold is not None for one in answer.explanations)
    return "<p>Held out: log likelihood gained over the base model on the half that helps to name.</p>" if told else ""


def _set_aside(answer: Verdict) -> str:
    """Sets that are not among the explanations, and what their sizes would be."""
    sets = "; ".join(f"{listed(one.effects)} ({one.sizes})" for one in answer.unsupported)
    return _paragraphs([f"Set aside, as a size may as well be nothing: {sets}."] if sets else [])


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
    """Print the warnings and the sentence of a finished diagnosis, and the paths of what it wrote."""
    answer = json.loads((folder.path / "verdict.json").read_text())
    print(*answer.get("warnings", []), answer["sentence"], sep="\n")
    if answer["separating_experiment"]:
        print(answer["separating_experiment"])
    print()
    for name in ("verdict.json", "extended.yaml", "report.html"):
        if (folder.path / name).exists():
            print(folder.path / name)
