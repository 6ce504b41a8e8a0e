"""What a diagnosis found, put into the answer's form."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.inference.directions import SPAN
from vehicle_sbi.inference.information import SEEN
from vehicle_sbi.mismatch.answer.schema import (
    Followed,
    Latent,
    Named,
    Outgrown,
    Score,
    Unknown,
    Unsupported,
    Verdict,
    Visible,
)
from vehicle_sbi.mismatch.answer.wording import NAMED, Context, headline, lines, widen
from vehicle_sbi.mismatch.design.experiment import advice
from vehicle_sbi.mismatch.design.identifiability import Card
from vehicle_sbi.mismatch.estimation.estimate import Estimate, drawn, told
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.fit_check import FitCheck
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.hypotheses.block import Stretch, clock, own_time, stretches
from vehicle_sbi.mismatch.hypotheses.discrepancy import Remainder
from vehicle_sbi.mismatch.problem.case import Case
from vehicle_sbi.mismatch.selection.acceptance import judged
from vehicle_sbi.mismatch.selection.detection import Examined
from vehicle_sbi.mismatch.selection.extended import Extended, alternatives
from vehicle_sbi.mismatch.selection.predictive import Gain, Prediction
from vehicle_sbi.mismatch.selection.pruned import Pruned
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.words import enumerated

SCHEMA = 2
LISTED = 40  # sets of effects at most
FEWEST = 30  # draws of a set, from which its parameters are said by those alone
TOO_FEW = 10  # draws of all sets, below which a size is not said: its standard deviation is known to a quarter at best
LEAST = 0.05  # probability from which one that is not is listed
CORNERED = 2  # base parameters on rims, from which the fit is said to be in a corner
MISFIT = 2.0  # times the sensor's own noise, from which what is left over is worth a warning
CUT = 2.0  # standard deviations, within which a limit of its prior cuts a parameter's interval
NARROW = 0.5  # of its prior's standard deviation, from which an interval is near the limits wherever it lies
STUCK = 0.2  # share of the draws beyond a parameter's box, from which it would leave it


@dataclass(frozen=True)
class Found:
    """What the steps of a diagnosis have found, each from those before it."""

    fit_check: FitCheck
    examined: Examined
    pruned: Pruned | None
    extended: Extended
    predictions: Mapping[str, Prediction]
    gained: Gain | None
    seen: Card

    @property
    def base(self) -> Model:
        """The base model."""
        return Model.without_effects(self.examined.fit)


def verdict(case: Case, found: Found) -> Verdict:
    """Everything that the diagnosis found, put into the answer's form."""
    model, pruned, detected = found.extended.model, found.pruned, found.examined.detected
    before = found.base.estimates
    after = {p.name: drawn(pruned.draws(p.name), p.unit) for p in pruned.expansion.base} if pruned else before
    accepted = judged(case.observation, case.held_out, found.predictions, found.gained) if model.effects else None
    fit: dict[str, object] = {"heldout": list(case.held_out_names)}
    fit |= {name: asdict(_score(prediction)) for name, prediction in found.predictions.items()}
    fit |= {} if found.gained is None else {"gain_log_score": asdict(found.gained)}
    fit |= {} if accepted is None else {"accepted": accepted.accepted, "accepted_because": accepted.because}
    warnings = [*case.warnings, *_warnings(found), *_cut(pruned, after)]
    alike = alternatives(pruned, found.seen.alike) if pruned and detected else []
    answer = Verdict(
        schema=SCHEMA,
        headline="",
        lines=[],
        detected=detected,
        p_value=found.examined.p_value,
        mismatch=found.examined.places,
        explanations=_explanations(pruned, model),
        effects=pruned.effects if pruned else {},
        p_none=float((pruned.nothing & ~pruned.unexplained).mean()) if pruned else float(not detected),
        p_unknown=float(pruned.unexplained.mean()) if pruned else float(detected),
        p_unknown_alone=float((pruned.nothing & pruned.unexplained).mean()) if pruned else float(detected),
        share_explained=_share_explained(found.base.fit, model.fit) if model.effects else None,
        unknown=_unknown(pruned) if pruned and detected else None,
        indistinguishable=alike,
        p_indistinguishable=[pruned.any_of(group) for group in alike] if pruned else [],
        separating_experiment=_advice(case, found.extended),
        fit=fit,
        base_parameters={
            p.name: {
                "before": _plain(before[p.name]),
                "after": _plain(after[p.name]),
                "unit": p.unit,
                "identified": told(after[p.name].std, p.low, p.high),
            }
            for p in found.base.fit.simulator.space.parameters
        },
        could_show={
            name: Visible(c.parameter.name, c.size, c.parameter.unit) for name, c in found.seen.could_show().items()
        },
        invisible=[name for name in found.seen.invisible() if not (pruned and name in pruned.effects)],
        cannot_act=found.seen.cannot_act,
        unsupported=_unsupported(pruned) if pruned and detected else [],
        warnings=warnings,
        wrong_recordings=[*case.wrong],
        notes=[*warnings, *_unpredicted(found), *case.notes],
        sentence="",
    )
    trusted = found.fit_check.trusted and not _cornered(found.base, "base") and not case.wrong
    return _in_words(answer, found, trusted=trusted)


def _in_words(answer: Verdict, found: Found, *, trusted: bool) -> Verdict:
    """The answer with its headline, the lines after it and both as one text."""
    context = Context(found.base.fit.simulator, found.seen, found.predictions, trusted)
    answer = replace(answer, headline=headline(answer, trusted=trusted))
    more = lines(answer, context)
    return replace(answer, lines=more, sentence=" ".join([answer.headline, *more]))


def _advice(case: Case, found: Extended) -> str:
    """What would tell the likeliest model from another, recordings that were held out included."""
    if found.other is None:
        return ""
    return advice(found.model, found.other, case.held_out if case.apart and case.held_out.anything else None)


def _explanations(pruned: Pruned | None, model: Model) -> list[Named]:
    """Sets of effects that were drawn, the likeliest first."""
    if pruned is None:
        return []
    sets = [(effects, rows) for effects, rows in pruned.sets.items() if effects]
    return [_named(pruned, effects, rows, model) for effects, rows in sets[:LISTED]]


def _named(pruned: Pruned, effects: tuple[str, ...], rows: np.ndarray, model: Model) -> Named:
    alone, beside = float((rows & ~pruned.unexplained).mean()), float((rows & pruned.unexplained).mean())
    own = _parameters(pruned, effects, rows)
    if model.posterior is not None and effects == model.effects:
        own = {name: e for (name, e), mine in zip(model.estimates.items(), model.own, strict=True) if mine}
    return Named(effects, alone, beside, own, _acts(pruned, effects))


def _parameters(pruned: Pruned, effects: Sequence[str], rows: np.ndarray) -> dict[str, Estimate]:
    """Of a set's effects the parameters that are away from their nulls in it, from its own draws if they suffice; none
    that hardly was drawn at all."""
    space, expansion = pruned.fit.simulator.space, pruned.expansion
    names, sizes = [p.name for p in expansion.sizes], pruned.mostly(effects, rows)
    found = dict[str, Estimate]()
    for p in (*expansion.sizes, *expansion.shapes):
        if p.name.split(".")[0] not in effects or (p.name in names and p.name not in sizes):
            continue
        there = pruned.included[:, names.index(p.name)] if p.name in names else pruned.missing[p.name.split(".")[0]]
        if there.sum() < TOO_FEW:
            continue
        chosen = rows & there if (rows & there).sum() >= FEWEST else there
        found[p.name] = drawn(pruned.theta[chosen, space.column(p.name)], p.unit)
    return found


def _acts(pruned: Pruned, effects: Sequence[str]) -> dict[str, list[Stretch]]:
    """When each effect that is tied to the clock acts: a profile throughout, what comes and goes from the median of
    when it begins to that of when it ends."""
    space, found = pruned.fit.simulator.space, dict[str, list[Stretch]]()
    for effect in (name for name in effects if CATALOGUE[name].timed):
        start, stop = 0.0, np.inf
        if all(f"{effect}.{key}" in space.names for key in SPAN):
            there = pruned.missing[effect]
            begun, lasting = (pruned.theta[there, space.column(f"{effect}.{key}")] for key in SPAN)
            start, stop = float(np.median(begun)), float(np.median(begun + lasting))
        found[effect] = own_time(pruned.fit.simulator, start, stop)
    return found


def _unsupported(pruned: Pruned) -> list[Unsupported]:
    """Effects that are neither likely to be missing nor sure not to be."""
    doubtful = [(name, p) for name, p in pruned.effects.items() if LEAST <= p <= NAMED]
    return [Unsupported((name,), _parameters(pruned, [name], pruned.missing[name]), p) for name, p in doubtful]


def _share_explained(base: Fit, extended: Fit) -> float:
    """Of the misfit beyond the extended model's noise, in its units, what it takes away."""
    samples = float(base.simulator.windows.valid.sum())
    before, after = (float(np.sum(extended.metric(fit.residual) ** 2)) for fit in (base, extended))
    return float(np.clip(1.0 - (after - samples) / max(before - samples, 1e-12), 0.0, 1.0))


def _unknown(pruned: Pruned) -> Unknown | None:
    """What no effect stands for, as far as the recordings show it, and base parameters that are stuck at a bound."""
    effects = next(iter(pruned.sets))
    shown = [one for one in pruned.remainders if one.shown >= SEEN]
    laws = [_law(one, effects) for one in shown]
    outgrown = _outgrown(pruned, effects)
    if not laws and not outgrown:
        return None
    return Unknown(effects, laws, outgrown, _over_time(pruned.fit, shown[0]) if shown else None)


def _law(one: Remainder, effects: tuple[str, ...]) -> Followed:
    size = drawn(one.rms, one.target.size.unit)
    return Followed(one.target.name, one.signal, size, effects, one.probability, one.followed)


def _over_time(fit: Fit, one: Remainder) -> Latent:
    """A load or error in each stretch of time, on average."""
    t = clock(fit.simulator)
    within = {span: (t >= span[0]) & (t <= span[1]) for span in stretches(fit.simulator)}
    spans = [span for span, inside in within.items() if inside.any()]
    size = [float(one.course[within[span]].mean()) for span in spans]
    most = own_time(fit.simulator, *spans[int(np.argmax(np.abs(size)))])
    starts, stops = zip(*spans, strict=True)
    return Latent(one.target.name, one.target.size.unit, [*starts], [*stops], size, 0.5 * one.shown**2, most)


def _outgrown(pruned: Pruned, effects: tuple[str, ...]) -> list[Outgrown]:
    found = list[Outgrown]()
    for p in pruned.expansion.base:
        below, above = pruned.beyond[:, pruned.expansion.space.column(p.name)].tolist()
        if below + above > STUCK:
            estimate, bound = drawn(pruned.draws(p.name), p.unit), p.low if below > above else p.high
            found.append(
                Outgrown({p.name: estimate}, {p.name: (p.low, p.high)}, effects, below + above, {p.name: bound})
            )
    return found


def _warnings(found: Found) -> list[str]:
    """Why the base model's fit may not be relied on."""
    models = {"base": found.base} | ({"extended": found.extended.model} if found.extended.model.effects else {})
    cornered = [line for called, one in models.items() for line in _cornered(one, called)]
    on_rims = [line for called, one in models.items() for line in _rim(one, called)]
    return [*cornered, *found.fit_check.notes, *on_rims, *_misfit(found.base.fit)]


def _cut(pruned: Pruned | None, after: Mapping[str, Estimate]) -> list[str]:
    """Base parameters whose interval, with what is missing averaged over, ends at a limit of their prior that is not
    their null, beyond which there is nothing."""
    cut = list[str]()
    for p in pruned.expansion.base if pruned else ():
        one, spread = after[p.name], (p.high - p.low) / np.sqrt(12.0)
        off, limit = min((abs(one.mean - end), end) for end in (p.low, p.high))
        narrow, near = one.std < NARROW * spread, off < CUT * one.std
        if narrow and near and limit != p.null:
            cut.append(f"{p.name} ({_nearer(p, one.mean)})")
    if not cut:
        return []
    return [
        f"With what is missing averaged over, limits of priors cut the intervals of {enumerated(cut)}: wider ones may "
        "move them."
    ]


def _unpredicted(found: Found) -> list[str]:
    """Which models spin out where something was held out."""
    models = ("base", "extended") if found.extended.model.effects else ("base",)
    missing = [name for name in models if name not in found.predictions]
    return [f"The {name} model cannot be simulated in what was held out." for name in missing]


def _score(prediction: Prediction) -> Score:
    return Score(
        prediction.nrmse, prediction.mean_crps, prediction.mean_log_score, prediction.coverage90, prediction.seconds
    )


def _on_rims(model: Model) -> list[tuple[Parameter, float]]:
    """Base parameters that want to leave their box, and where in it they are: what is missing may hide in them."""
    fit = model.fit
    off = ~fit.inside & ~model.own
    rows = zip(fit.simulator.space.parameters, fit.theta, off, strict=True)
    return [(p, float(x)) for p, x, out in rows if out]


def _rim(model: Model, called: str) -> list[str]:
    """What is said of each of them."""
    return [
        f"{p.name}: the {called} model fits best at {_nearer(p, x)}, a bound of its prior: it is too narrow, "
        "or a mismatch hides there."
        for p, x in _on_rims(model)
    ]


def _nearer(p: Parameter, x: float) -> str:
    """The nearer bound, with its unit."""
    return f"{p.low if x - p.low < p.high - x else p.high:.4g} {p.unit}".removesuffix(" 1")


def _cornered(model: Model, called: str) -> list[str]:
    """What is said first of a model that ends on several rims."""
    at_bounds = [(p.name, (p.low, p.high), x) for p, x in _on_rims(model)]
    if len(at_bounds) < CORNERED:
        return []
    return [
        f"The {called} model's best fit is at bounds of {len(at_bounds)} priors at once: what is missing hides in its "
        f"parameters, and the named effects are uncertain. {widen(at_bounds)}"
    ]


def _misfit(fit: Fit) -> list[str]:
    """Channels in which the base model leaves over more than the sensor's own noise."""
    windows, noise = fit.simulator.windows, fit.simulator.noise
    return [
        f"{name}: what the base model leaves over is {times:.2g} times the sensor's own noise of "
        f"{own:.2g} {CHANNELS[name].unit}, told by its fast scatter: misfit, not noise."
        for name, times, own in zip(windows.channels, noise.misfit, noise.of_sensor.floor, strict=True)
        if times > MISFIT
    ]


def _plain(e: Estimate) -> dict[str, float]:
    return {"mean": e.mean, "std": e.std, "q05": e.q05, "q95": e.q95}
