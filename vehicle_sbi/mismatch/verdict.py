"""The answer: as a typed value, as a sentence, and as the JSON that other tools read."""

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np
from jaxtyping import Float
from scipy.stats import norm, truncnorm

from vehicle_sbi.mismatch.beyond import Beyond
from vehicle_sbi.mismatch.case import Case
from vehicle_sbi.mismatch.examine import Model
from vehicle_sbi.mismatch.experiment import advice
from vehicle_sbi.mismatch.explanation import Explanation, doubted
from vehicle_sbi.mismatch.fit import Fit
from vehicle_sbi.mismatch.gate import Gate
from vehicle_sbi.mismatch.improve import Gain, Prediction
from vehicle_sbi.mismatch.latent import Latent, what_it_takes
from vehicle_sbi.mismatch.laws import Law
from vehicle_sbi.mismatch.locate import merged
from vehicle_sbi.mismatch.loose import Loose
from vehicle_sbi.mismatch.separability import Card
from vehicle_sbi.physics.effects import CATALOGUE

SCHEMA = 1
LISTED = 40  # explanations at most
SPELLED_OUT = 5  # parameters of an effect at most
ALTERNATIVES = 5  # explanations that are named beside the likeliest one
LIKELY = 0.02  # probability of sets, from which doubts about them are worth a note
SPOKEN_OF = 0.2  # probability of something unknown from which it is said what that would be


@dataclass(frozen=True)
class Place:
    """Where simulation and recording differ, times [s] of the recordings one after another."""

    channel: str
    from_s: float
    to_s: float
    p_value: float
    share_of_misfit: float
    regime: str


@dataclass(frozen=True)
class Estimate:
    """A parameter's posterior."""

    mean: float
    std: float
    q05: float
    q95: float
    unit: str


@dataclass(frozen=True)
class Named:
    """A set of effects, how probable it is that they are all that is missing, and that they and something unknown are,
    the size of its parameters, and how much likelier it makes the recordings that help to name (log likelihood)."""

    effects: tuple[str, ...]
    probability: float
    beside_unknown: float
    parameters: dict[str, Estimate]
    foretold: float | None


@dataclass(frozen=True)
class Followed:
    """A law outside the catalogue: a target that follows a signal of the drive, its size where the signal has its root
    mean square, the effects that it stands beside, and how probable it is."""

    target: str
    signal: str
    size: Estimate
    effects: tuple[str, ...]
    probability: float

    @property
    def sentence(self) -> str:
        """The law, in words."""
        beside = f" beside {_listed(self.effects)}" if self.effects else ""
        size = quantity("", self.size).removeprefix(" = ")
        return (
            f"The likeliest law outside the catalogue{beside}: {self.target} that follows {self.signal}, "
            f"{size} at its root mean square."
        )


@dataclass(frozen=True)
class Outgrown:
    """Base parameters beyond the boxes (low, high) of their priors, the effects that they stand beside, and how
    probable it is."""

    parameters: dict[str, Estimate]
    prior: dict[str, tuple[float, float]]
    effects: tuple[str, ...]
    probability: float

    @property
    def sentence(self) -> str:
        """Where they would lie, in words."""
        beside = f" beside {_listed(self.effects)}" if self.effects else ""
        boxes = {name: f"prior {low:.6g} to {high:.6g}" for name, (low, high) in self.prior.items()}
        found = [f"{quantity(name, e)} ({boxes[name]})" for name, e in self.parameters.items()]
        return (
            f"Likelier than any law outside the catalogue{beside}: {' and '.join(found)}; the prior is too narrow, or "
            "something that is not in the catalogue acts as if it were."
        )


@dataclass(frozen=True)
class Unknown:
    """What is missing where no known effect is it: laws, the likeliest first, base parameters that would lie beyond
    their priors, what load or error over time, and which known effects are likely to be missing beside it."""

    effects: tuple[str, ...]
    laws: list[Followed]
    beyond_prior: list[Outgrown]
    over_time: Latent | None

    @property
    def sentence(self) -> str:
        """The likeliest of them, and what it takes over time."""
        likeliest = sorted([*self.laws[:1], *self.beyond_prior[:1]], key=lambda one: -one.probability)
        found: list[Followed | Outgrown | Latent] = [*likeliest[:1], *([self.over_time] if self.over_time else [])]
        return " ".join(one.sentence for one in found)


@dataclass(frozen=True)
class Score:
    """A model's prediction of what was held out."""

    nrmse: dict[str, float]
    log_score: float
    coverage90: float


@dataclass(frozen=True)
class Verdict:
    """What the diagnosis says; its fields are those of verdict.json. `effects`: how probable it is that each of them is
    missing, whatever else is."""

    schema: int
    detected: bool
    p_value: float
    mismatch: list[Place]
    explanations: list[Named]
    effects: dict[str, float]
    p_none: float
    p_unknown: float
    unknown: Unknown | None
    indistinguishable: list[list[str]]
    separating_experiment: str
    fit: dict[str, object]
    base_parameters: dict[str, object]
    notes: list[str]
    sentence: str

    def as_json(self) -> dict[str, object]:
        return asdict(self)


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
    return [Place(b.channel, b.from_s, b.to_s, smallest[b], energy / total, b.regime) for b, energy in whole]


def _named(explanation: Explanation, k: int) -> Named:
    model = explanation.models[k]
    own = {
        name: value
        for name, value in estimates(model, explanation.temper).items()
        if name.split(".")[0] in model.effects
    }
    beside = explanation.beside_unknown.get(model.effects, 0.0)
    foretold = None if explanation.p_told is None else model.told
    return Named(model.effects, explanation.probability[k], beside, own, foretold)


def verdict(
    case: Case,
    passed: Gate,
    explanation: Explanation,
    predictions: Mapping[str, Prediction],
    gained: Gain | None,
    seen: Card,
) -> Verdict:
    """Everything that the diagnosis found, put into the answer's form."""
    model = chosen(explanation)
    before, after = (estimates(one, explanation.temper) for one in (explanation.base.model, model))
    together = explanation.indistinguishable() if explanation.detected else []
    unknown = _unknown(explanation) if explanation.p_unknown > SPOKEN_OF else None
    fit: dict[str, object] = {"heldout": list(case.held_out_names)}
    fit |= {name: asdict(Score(p.nrmse, p.mean_log_score, p.coverage90)) for name, p in predictions.items()}
    if gained is not None:
        fit["gain_log_score"] = asdict(gained)
    found = [_named(explanation, k) for k in range(min(len(explanation.models), LISTED))]
    rest = sum(explanation.probability[LISTED:])
    return Verdict(
        schema=SCHEMA,
        detected=explanation.detected,
        p_value=explanation.p_value,
        mismatch=places(explanation) if explanation.detected else [],
        explanations=found,
        effects=explanation.single,
        p_none=explanation.p_none,
        p_unknown=explanation.p_unknown + rest,
        unknown=unknown,
        indistinguishable=exchangeable(together),
        separating_experiment=_advice(explanation, together),
        fit=fit,
        base_parameters={
            name: {"before": _plain(before[name]), "after": _plain(after[name]), "unit": before[name].unit}
            for name in before
        },
        notes=[*passed.notes, *_rim(explanation.base.model.fit), *_doubts(explanation), *case.notes],
        sentence=sentence(explanation, gained, together, seen, unknown),
    )


def _unknown(explanation: Explanation) -> Unknown:
    """What lies outside the catalogue and is at all likely, and what it takes beyond the best set of known effects."""
    laws, outgrown = list[Followed](), list[Outgrown]()
    for model, probability in explanation.laws[:LISTED]:
        if isinstance(model.outside, Beyond):
            outgrown.append(_outgrown(model, model.outside, probability, explanation.temper))
        elif model.outside is not None:
            name, signal = model.outside.target.name, model.outside.signal
            size = _size(model, model.outside, explanation.temper)
            laws.append(Followed(name, signal, size, model.effects, probability))
    beside, takes = next(iter(explanation.beside_unknown)), what_it_takes(explanation.best.model.fit)
    return Unknown(beside, laws, outgrown, takes)


def _outgrown(model: Model, beyond: Beyond, probability: float, power: float) -> Outgrown:
    found = {name: e for name, e in estimates(model, power).items() if name in beyond.boxes}
    return Outgrown(found, dict(beyond.boxes), model.effects, probability)


def _size(model: Model, outside: Law | Loose, power: float) -> Estimate:
    """Of what a model has that the catalogue does not."""
    if isinstance(outside, Law):
        return estimates(model, power)[outside.target.size.name]
    mean, std = outside.size, outside.std
    low, high = norm.ppf([0.05, 0.95], mean, max(std, 1e-12))
    return Estimate(mean, std, max(float(low), 0.0), float(high), outside.target.size.unit)


def exchangeable(together: Sequence[Sequence[str]]) -> list[list[str]]:
    """Groups of effects that stand for each other: exchanging one for another makes one explanation of the next."""
    groups: list[set[str]] = []
    for a, b in itertools.combinations([set(effects) for effects in together], 2):
        if len(a - b) == len(b - a) == 1:
            pair = a ^ b
            pair = pair.union(*(group for group in groups if group & pair))
            groups = [group for group in groups if not group & pair] + [pair]
    return [sorted(group) for group in groups]


def _rim(fit: Fit) -> list[str]:
    """Base parameters that want to leave their box: what is missing may hide in them."""
    names = np.array(fit.simulator.space.names)[~fit.inside]
    return [f"{name} lies on the edge of its prior in the base model, where a mismatch may hide." for name in names]


def _doubts(explanation: Explanation) -> list[str]:
    """Which of the likely explanations recordings that were held out speak against."""
    return [
        f"{_listed(model.effects)} would predict held-out recordings worse than the base model does: what it stands "
        "for is likely to be something else."
        for model, probability in zip(explanation.models, explanation.standing, strict=True)
        if doubted(model) and probability > LIKELY
    ]


def _advice(explanation: Explanation, together: Sequence[tuple[str, ...]]) -> str:
    """The experiment that separates the two most probable explanations, where they are hard to tell apart."""
    return advice(*explanation.models[:2]) if len(together) > 1 else ""


def _plain(estimate: Estimate) -> dict[str, float]:
    return {"mean": estimate.mean, "std": estimate.std}


def chosen(explanation: Explanation) -> Model:
    """The model to go on with: the most probable set of effects, or the base model where nothing was detected."""
    if not explanation.detected or not explanation.models:
        return explanation.base.model
    return explanation.models[0]


def quantity(name: str, e: Estimate) -> str:
    """`body_roll.gradient = 0.0081 ± 0.0004 rad/(m/s^2)`."""
    digits = max(0, -int(np.floor(np.log10(max(e.std, 1e-12))))) if e.std < 10 else 0
    return f"{name} = {e.mean:.{min(digits, 9)}f} ± {e.std:.{min(digits, 9)}f} {e.unit}".removesuffix(" 1")


def sentence(
    explanation: Explanation,
    gained: Gain | None,
    together: Sequence[Sequence[str]],
    seen: Card,
    unknown: Unknown | None,
) -> str:
    """The diagnosis in a few sentences, for people."""
    if not explanation.detected:
        return (
            f"Nothing is missing as far as these recordings can tell (p = {explanation.p_value:.2g}): "
            f"what is left over looks like noise. {_limits(seen)}"
        )
    said = [_difference(explanation), *_answer(explanation)]
    if unknown is not None and unknown.sentence:
        said.append(unknown.sentence)
    others = [effects for effects in together if effects != explanation.models[0].effects]
    if others:
        named = [_listed(one) for one in others[:ALTERNATIVES]]
        more = len(others) - len(named)
        named += [f"{more} more {'set' if more == 1 else 'sets'} of effects"] if more else []
        said.append(f"These recordings cannot tell it from {', or '.join(named)}.")
        said.append(_whatever_else(explanation.single))
    if gained is not None:
        gain = f"On held-out data the extended model gains {gained.mean:.2g} ± {gained.std:.1g} of log score a sample"
        said.append(f"{gain}." if gained.certain else f"{gain}, which is not certain to be a gain.")
    return " ".join(said)


def _difference(explanation: Explanation) -> str:
    """That they differ, and where most."""
    where = [
        f", most of all in {place.channel} {_when(place.regime, place.from_s, place.to_s)}"
        for place in places(explanation)[:1]
    ]
    return f"Simulation and recording differ (p = {explanation.p_value:.2g}){''.join(where)}."


def _answer(explanation: Explanation) -> list[str]:
    """What explains it, as far as anything known does."""
    if not explanation.models:
        return ["No known effect explains any of it."]
    best = explanation.models[0]
    verb = "explains" if len(best.effects) == 1 else "explain"
    named = f"{_listed(best.effects)} {verb} it with probability {explanation.probability[0]:.2f}"
    if explanation.p_unknown > sum(explanation.probability):
        left, examined = explanation.best.largest_block, explanation.best.model.effects == best.effects
        share = f"{explanation.best.share_explained:.0%} at most" if examined else "a part of it"
        named = (
            f"No known effect explains all of it: {_listed(best.effects)} {verb} {share}, and something unknown "
            f"remains in {left.channel} {_when(left.regime, left.from_s, left.to_s)}"
        )
    meaning = "; ".join(CATALOGUE[name].meaning for name in best.effects)
    own = {k: v for k, v in estimates(best, explanation.temper).items() if k.split(".")[0] in best.effects}
    sizes = "; ".join(size for name in best.effects for size in _sizes(name, own))
    return [f"{named}: {meaning} ({sizes})."]


def _sizes(effect: str, own: Mapping[str, Estimate]) -> list[str]:
    """The sizes of an effect's parameters; of a profile its range."""
    values = {name: e for name, e in own.items() if name.split(".")[0] == effect}
    if len(values) <= SPELLED_OUT:
        return [quantity(name, e) for name, e in values.items()]
    low, high = min(e.mean for e in values.values()), max(e.mean for e in values.values())
    return [f"{effect}: {len(values)} values from {low:.2g} to {high:.2g} {next(iter(values.values())).unit}"]


def _whatever_else(single: Mapping[str, float]) -> str:
    """How probable each effect is over all sets that hold it; the likeliest one and those that are at all likely."""
    likely = [f"{name} {p:.2f}" for k, (name, p) in enumerate(single.items()) if k == 0 or p > SPOKEN_OF]
    return f"Whatever else is missing, the probability that an effect is: {', '.join(likely[:ALTERNATIVES])}."


def _limits(seen: Card) -> str:
    """What could not have been seen at all."""
    hidden = [c.parameter.name for c in seen.candidates if not c.visible]
    if len(hidden) == len(seen.candidates):
        return "But they are too short or too gentle to show any known effect."
    return f"They would have shown {len(seen.candidates) - len(hidden)} of {len(seen.candidates)} known effects."


def _listed(effects: Sequence[str]) -> str:
    return " with ".join(effects)


def _when(regime: str, start: float, stop: float) -> str:
    return f"where {regime}" if regime else f"from {start:.1f} to {stop:.1f} s"
