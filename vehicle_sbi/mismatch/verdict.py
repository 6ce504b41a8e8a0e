"""What a diagnosis found, put into the answer's form."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, truncnorm

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.inference.directions import SPAN
from vehicle_sbi.mismatch.acceptance import judged
from vehicle_sbi.mismatch.agreement import disagreeing
from vehicle_sbi.mismatch.answer import (
    Estimate,
    Followed,
    Named,
    Outgrown,
    Place,
    Score,
    Unknown,
    Unsupported,
    Verdict,
    Visible,
    listed,
)
from vehicle_sbi.mismatch.beyond import Beyond
from vehicle_sbi.mismatch.case import Case
from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.experiment import advice
from vehicle_sbi.mismatch.explanation import Explanation, doubted
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.gate import Gate
from vehicle_sbi.mismatch.improve import Gain, Prediction
from vehicle_sbi.mismatch.latent import what_it_takes
from vehicle_sbi.mismatch.laws import Law
from vehicle_sbi.mismatch.locate import Stretch, lies_in, merged, own_time
from vehicle_sbi.mismatch.loose import Loose
from vehicle_sbi.mismatch.model_average import averaged
from vehicle_sbi.mismatch.onset import Onset
from vehicle_sbi.mismatch.selection.expand_and_prune import Pruned
from vehicle_sbi.mismatch.separability import Card
from vehicle_sbi.mismatch.wording import SPOKEN_OF, distrusted, sentence
from vehicle_sbi.physics.effects import CATALOGUE

SCHEMA = 1
LISTED, DOUBTED = 40, 5  # explanations at most, and sets that may be nothing
LIKELY = 0.02  # probability of sets, from which doubts about them are worth a note
CORNERED = 2  # base parameters on rims, from which the fit is said to be in a corner
MISFIT = 2.0  # times the sensor's own noise, from which what is left over is worth a warning


def estimates(model: Model, power: float = 1.0) -> dict[str, Estimate]:
    """Posterior of every free parameter of a model: as it was drawn, else normal about the fit within its box, under
    its likelihood to a power."""
    fit, space = model.fit, model.fit.simulator.space
    if model.posterior is not None:
        return {p.name: _drawn(draws, p.unit) for p, draws in zip(space.parameters, model.posterior.T, strict=True)}
    std, found = np.sqrt(np.diag(fit.tempered(power))), {}
    for p, mean, s in zip(space.parameters, fit.theta, std, strict=True):
        box = truncnorm((p.low - mean) / s, (p.high - mean) / s, loc=mean, scale=s)
        low, high = box.ppf([0.05, 0.95])
        found[p.name] = Estimate(float(box.mean()), float(box.std()), float(low), float(high), p.unit)
    return found


def _drawn(draws: Float[np.ndarray, " n"], unit: str) -> Estimate:
    """A parameter's posterior from draws."""
    low, high = np.quantile(draws, [0.05, 0.95])
    return Estimate(float(draws.mean()), float(draws.std()), float(low), float(high), unit)


def places(explanation: Explanation) -> list[Place]:
    """Blocks in which the base model leaves more than noise would, the largest first."""
    free, scores = explanation.base.free, explanation.base.scores
    z, p = scores.z[free.of_blocks], scores.p_values[free.of_blocks]
    significant = np.flatnonzero(p < 0.05)
    whole = merged([free.blocks[k] for k in significant], z[significant])
    total = sum(energy for _, energy in whole)
    smallest = {place: min(float(p[k]) for k in significant if place.holds(free.blocks[k])) for place, _ in whole}
    simulator = explanation.base.model.fit.simulator
    return [
        Place(b.channel, b.from_s, b.to_s, smallest[b], energy / total, b.regime, lies_in(simulator, b))
        for b, energy in whole
    ]


def _named(explanation: Explanation, k: int) -> Named:
    model = explanation.models[k]
    every = estimates(model, explanation.temper).items()
    own = {name: value for (name, value), mine in zip(every, model.own, strict=True) if mine}
    beside = explanation.beside_unknown.get(model.effects, 0.0)
    foretold = None if explanation.p_told is None else model.told
    return Named(model.effects, explanation.probability[k], beside, own, foretold, _acts(model, own))


def _unsupported(model: Model, power: float) -> Unsupported:
    own = zip(estimates(model, power).items(), model.own, strict=True)
    return Unsupported(model.effects, {name: value for (name, value), mine in own if mine})


def _acts(model: Model, own: Mapping[str, Estimate]) -> dict[str, list[Stretch]]:
    """When each effect that is tied to the clock acts: a profile throughout, what comes and goes from the median of
    when it begins to that of when it ends."""
    space, found = model.fit.simulator.space, dict[str, list[Stretch]]()
    draws = model.fit.theta[None] if model.posterior is None else model.posterior
    for effect in (name for name in model.effects if CATALOGUE[name].timed):
        start, stop = 0.0, np.inf
        if all(f"{effect}.{key}" in own for key in SPAN):
            begun, lasting = (draws[:, space.column(f"{effect}.{key}")] for key in SPAN)
            start, stop = float(np.median(begun)), float(np.median(begun + lasting))
        found[effect] = own_time(model.fit.simulator, start, stop)
    return found


def verdict(
    case: Case,
    passed: Gate,
    explanation: Explanation,
    predictions: Mapping[str, Prediction],
    gained: Gain | None,
    seen: Card,
    pruned: Pruned | None = None,
) -> Verdict:
    """Everything that the diagnosis found, put into the answer's form."""
    model = chosen(explanation)
    before, after = estimates(explanation.base.model, explanation.temper), averaged(explanation)
    if pruned is not None:
        after = {p.name: _drawn(pruned.draws(p.name), p.unit) for p in pruned.expansion.base}
    accepted = None if model is explanation.base.model else judged(case.observation, case.held_out, predictions, gained)
    together = explanation.indistinguishable() if explanation.detected else []
    unknown = _unknown(explanation) if explanation.p_unknown > SPOKEN_OF else None
    covered = predictions["base"].coverage90 if "base" in predictions else 0.0
    fit: dict[str, object] = {"heldout": list(case.held_out_names)}
    fit |= {name: asdict(_score(prediction)) for name, prediction in predictions.items()}
    if gained is not None:
        fit["gain_log_score"] = asdict(gained)
    if accepted is not None:
        fit |= {"accepted": accepted.accepted, "accepted_because": accepted.because}
    found = [_named(explanation, k) for k in range(min(len(explanation.models), LISTED))]
    mismatch = places(explanation) if explanation.detected else []
    rest = sum(explanation.probability[LISTED:])
    models = {"base": explanation.base.model, "extended": model}
    on_rims = {called: _rim(one, called) for called, one in models.items() if called == "base" or one.effects}
    cornered = [line for called, lines in on_rims.items() for line in _cornered(lines, called)]
    misfit = _misfit(explanation.base.model.fit)
    warnings = [*case.warnings, *cornered, *passed.notes, *itertools.chain(*on_rims.values()), *misfit]
    doubtful = [_unsupported(model, explanation.temper) for model in explanation.doubtful[:DOUBTED]]
    said = sentence(explanation, found, doubtful, mismatch, together, unknown, accepted, seen, covered)
    return Verdict(
        schema=SCHEMA,
        detected=explanation.detected,
        p_value=explanation.p_value,
        mismatch=mismatch,
        explanations=found,
        effects=explanation.single,
        whatever_else={} if pruned is None else pruned.effects,
        p_none=explanation.p_none,
        p_unknown=explanation.p_unknown + rest,
        share_explained=_share_explained(explanation),
        unknown=unknown,
        indistinguishable=exchangeable(together),
        separating_experiment=_advice(explanation, together),
        fit=fit,
        base_parameters={
            name: {"before": _plain(before[name]), "after": _plain(after[name]), "unit": before[name].unit}
            for name in before
        },
        could_show={name: Visible(c.parameter.name, c.size, c.parameter.unit) for name, c in seen.could_show().items()},
        invisible=seen.invisible(),
        cannot_act=seen.cannot_act,
        unsupported=doubtful,
        warnings=warnings,
        notes=[*warnings, *_doubts(explanation), *_unpredicted(explanation, predictions), *case.notes],
        sentence=said if passed.trusted and not _cornered(on_rims["base"], "base") else distrusted(said),
    )


def _share_explained(explanation: Explanation) -> float | None:
    """By the likeliest set, where that is the one that was examined."""
    best = explanation.best
    return best.share_explained if chosen(explanation).effects == best.model.effects and explanation.detected else None


def _unpredicted(explanation: Explanation, predictions: Mapping[str, Prediction]) -> list[str]:
    """Which models spin out where something was held out."""
    models = ("base", "extended") if chosen(explanation) is not explanation.base.model else ("base",)
    return [f"The {name} model cannot be simulated in what was held out." for name in models if name not in predictions]


def _score(prediction: Prediction) -> Score:
    return Score(prediction.nrmse, prediction.mean_crps, prediction.mean_log_score, prediction.coverage90)


def _unknown(explanation: Explanation) -> Unknown:
    """What lies outside the catalogue and is at all likely, and what it takes beyond the best set of known effects."""
    laws, outgrown = list[Followed](), list[Outgrown]()
    for model, probability in explanation.laws[:LISTED]:
        if isinstance(model.outside, Beyond):
            outgrown.append(_outgrown(model, model.outside, probability, explanation.temper))
        elif model.outside is not None:
            name, signal = model.outside.target.name, model.outside.signal
            size = _size(model, model.outside, explanation.temper)
            onset = model.outside if isinstance(model.outside, Onset) else None
            acts, start_std = (onset.within, onset.start_std) if onset else ([], None)
            laws.append(Followed(name, signal, size, model.effects, probability, acts, start_std))
    beside, takes = next(iter(explanation.beside_unknown)), what_it_takes(explanation.best.model.fit)
    return Unknown(beside, laws, outgrown, takes)


def _outgrown(model: Model, beyond: Beyond, probability: float, power: float) -> Outgrown:
    found = {name: e for name, e in estimates(model, power).items() if name in beyond.boxes}
    return Outgrown(found, dict(beyond.boxes), model.effects, probability)


def _size(model: Model, outside: Law | Loose, power: float) -> Estimate:
    """Of what a model has that the catalogue does not."""
    if isinstance(outside, Law):
        return estimates(model, power)[outside.target.size.name]
    mean, std, least = outside.size, outside.std, -np.inf if isinstance(outside, Onset) else 0.0
    low, high = norm.ppf([0.05, 0.95], mean, max(std, 1e-12))
    return Estimate(mean, std, max(float(low), least), float(high), outside.target.size.unit)


def exchangeable(together: Sequence[Sequence[str]]) -> list[list[str]]:
    """Groups of effects that stand for each other: exchanging one for another makes one explanation of the next."""
    groups: list[set[str]] = []
    for a, b in itertools.combinations([set(effects) for effects in together], 2):
        if len(a - b) == len(b - a) == 1:
            pair = a ^ b
            pair = pair.union(*(group for group in groups if group & pair))
            groups = [group for group in groups if not group & pair] + [pair]
    return [sorted(group) for group in groups]


def _rim(model: Model, called: str) -> list[str]:
    """Base parameters that want to leave their box: what is missing may hide in them."""
    fit = model.fit
    names = np.array(fit.simulator.space.names)[~fit.inside & ~model.own]
    return [f"{name} lies on the edge of its prior in the {called} model, where a mismatch may hide." for name in names]


def _cornered(on_rims: Sequence[str], called: str) -> list[str]:
    """What is said first of a model that ends on several rims."""
    if len(on_rims) < CORNERED:
        return []
    return [
        f"The {called} model's fit ends on the edges of {len(on_rims)} priors at once: what is missing hides in its "
        "parameters, and names that follow are rough. State wider priors, or the constants that are known."
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


def _doubts(explanation: Explanation) -> list[str]:
    """Which of the likely explanations recordings that were held out speak against, and effects of the likeliest whose
    sizes differ between recordings."""
    differing = disagreeing(chosen(explanation)) if explanation.detected else []
    return [
        f"{name} would be of another size in each recording: what it stands for is likely to be something else."
        for name in differing
    ] + [
        f"{listed(model.effects)} would predict held-out recordings worse than the base model does: what it stands "
        "for is likely to be something else."
        for model, probability in zip(explanation.models, explanation.standing, strict=True)
        if doubted(model) and probability > LIKELY
    ]


def _advice(explanation: Explanation, together: Sequence[tuple[str, ...]]) -> str:
    """The experiment that separates the two most probable explanations that are hard to tell apart, if there are."""
    model = {one.effects: one for one in explanation.models}
    return advice(*(model[effects] for effects in together[:2])) if len(together) > 1 else ""


def _plain(e: Estimate) -> dict[str, float]:
    return {"mean": e.mean, "std": e.std, "q05": e.q05, "q95": e.q95}


def chosen(explanation: Explanation) -> Model:
    """The model to go on with: the most probable set of effects, or the base model where nothing was detected."""
    if not explanation.detected or not explanation.models:
        return explanation.base.model
    return explanation.models[0]
