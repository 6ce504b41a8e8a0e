"""Expand and prune: which effects are missing and what the base parameters are, whatever else is missing.

The model with every effect in is fitted under shrinkage, and made linear there; which of its columns are needed, and
how large they are, is sampled (`inclusion`). What was found says where to fit again, and how strongly to shrink: an
effect that is out is held to its null, the discrepancy that was found is taken off what was recorded. Draws of the
last rounds are pooled, since none of their linear models is the right one.
"""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.inference.directions import Direction, middle
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.elsewhere import elsewhere, under_own_noise
from vehicle_sbi.mismatch.estimation.expansion import WIDER, Expansion
from vehicle_sbi.mismatch.estimation.fit import SHARES, Fit, Shrinkage
from vehicle_sbi.mismatch.estimation.linear_gaussian import (
    LinearGaussian,
    linear_gaussian,
    order,
    plain_from,
    showing,
    to_nulls,
)
from vehicle_sbi.mismatch.hypotheses.dictionary import believed
from vehicle_sbi.mismatch.hypotheses.discrepancy import (
    Discrepancy,
    Remainder,
    Response,
    discrepancies,
    parts,
    remainders,
    responses,
)
from vehicle_sbi.mismatch.hypotheses.spans import likeliest_spans
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.inclusion import Chain, Groups, Sampled, Shared, sample
from vehicle_sbi.parameters import Parameter

LEAST_RMS = 0.02  # typical sizes, within which an effect that is out is held


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Rounds of fit and sampling, from which of the last ones draws are pooled, and the chains of those and of the ones
    before, which only say where to fit again."""

    rounds: int = 3
    pooled: int = 2
    first: Chain = field(default_factory=lambda: Chain(chains=2, sweeps=120, forgotten=40, every=2))
    last: Chain = field(default_factory=lambda: Chain(chains=2, sweeps=240, forgotten=80, every=2))


BUDGET = Budget()


@dataclass(frozen=True)
class Pruned:
    """Draws from the posterior over the expanded model: `theta` (n, d) in the parameters' units, `included` (n, sizes)
    says which sizes are away from their nulls, `discrepant` (n, groups) which discrepancies are as large as would be
    plain to see, `beyond` (d,) which share of draws lay beyond each parameter's box before they were folded back.
    `shows` (sizes) says which sizes would be seen beside the base parameters; others are not named, and only widen what
    is said of those."""

    expansion: Expansion
    theta: Float[np.ndarray, "n d"]
    included: Bool[np.ndarray, "n sizes"]
    discrepant: Bool[np.ndarray, "n groups"]
    beyond: Float[np.ndarray, " d"]
    shows: Bool[np.ndarray, " sizes"]
    fit: Fit
    remainders: list[Remainder]

    def away(self, effect: str) -> Bool[np.ndarray, " n"]:
        """In which draws an effect, whether it shows or not, is away from its null."""
        own = np.array([p.name.split(".")[0] == effect for p in self.expansion.sizes], dtype=bool)
        return np.any(self.included[:, own], axis=1)

    @cached_property
    def missing(self) -> dict[str, Bool[np.ndarray, " n"]]:
        """In which draws each effect that shows is away from its null."""
        showing = itertools.compress(self.expansion.sizes, self.shows)
        return {effect: self.away(effect) for effect in dict.fromkeys(p.name.split(".")[0] for p in showing)}

    @property
    def effects(self) -> dict[str, float]:
        """The probability that each effect is missing, whatever else is; the largest first."""
        found = {name: float(there.mean()) for name, there in self.missing.items()}
        return dict(sorted(found.items(), key=lambda one: -one[1]))

    def any_of(self, effects: Collection[str]) -> float:
        """The probability that at least one of some effects is missing."""
        return float(np.any([self.missing[name] for name in effects], axis=0).mean())

    @cached_property
    def unexplained(self) -> Bool[np.ndarray, " n"]:
        """In which draws there is a discrepancy, which no effect stands for, as large as would be plain to see."""
        return np.any(self.discrepant, axis=1)

    @cached_property
    def sets(self) -> dict[tuple[str, ...], Bool[np.ndarray, " n"]]:
        """Every set of effects that was drawn, with the draws that have it; the most frequent first."""
        names = np.array([*self.missing])
        drawn, of = np.unique(np.array([*self.missing.values()]).T, axis=0, return_inverse=True)
        order = np.argsort(-np.bincount(of.ravel()), kind="stable")
        return {tuple(sorted(names[drawn[k]].tolist())): of.ravel() == k for k in order}

    def draws(self, name: str) -> Float[np.ndarray, " n"]:
        """Of one parameter; of an effect's size, those in which it is missing, if there are any."""
        space = self.fit.simulator.space
        values = self.theta[:, space.column(name)]
        sizes = [p.name for p in self.expansion.sizes]
        chosen = self.included[:, sizes.index(name)] if name in sizes else np.ones(len(values), dtype=bool)
        return values[chosen] if chosen.any() else values


@dataclass(frozen=True)
class _Round:
    """Where a round begins: the expanded model, where to fit it from, how far sizes are held from their nulls (root
    mean square, in typical ones), and what was recorded less the discrepancy that is known so far."""

    expansion: Expansion
    start: Float[np.ndarray, " d"]
    rms: Float[np.ndarray, " sizes"]
    observation: Observation

    @classmethod
    def first(cls, base: Fit, expansion: Expansion) -> "_Round":
        start = np.concatenate([base.theta, expansion.rest[len(base.theta) :]])
        return cls(expansion, start, np.full(len(expansion.sizes), WIDER), expansion.observed(base))

    def first_fit(self, sleeping: Sequence[Parameter]) -> Fit | None:
        """From effects at their nulls, beside the base model's parameters as they were fitted and, as these have
        absorbed what is missing, beside the middle of their boxes; from effects as large as is expected of a car; and
        with those that change nothing near their nulls halfway into their boxes."""
        far = [self.start, self.expansion.rest, self.expansion.expected]
        if awake := {p.name: middle(p) for p in sleeping}:
            names = self.expansion.space.names
            far.append(np.array([awake.get(name, x) for name, x in zip(names, self.start, strict=True)]))
        return self.expansion.likeliest(self.observation, self.rms, far=far)

    def fitted(self) -> Fit | None:
        return self.expansion.fitted(self.observation, self.start, self.rms)

    def widened(self, expansion: Expansion) -> "_Round":
        """With more that is free, at its null."""
        start = _by_name(self.expansion.space.parameters, self.start, expansion.space.parameters, expansion.rest)
        rms = _by_name(self.expansion.sizes, self.rms, expansion.sizes, np.full(len(expansion.sizes), WIDER))
        return _Round(expansion, start, rms, self.observation.freeing(expansion.space.parameters))


def expand_and_prune(
    base: Fit,
    known: Sequence[Direction],
    naming: Observation | None,
    *,
    prior: EffectPrior,
    rng: np.random.Generator,
    budget: Budget = BUDGET,
) -> Pruned | None:
    """From the base model's fit on, with directions that are known to act and recordings that help to name, if any.

    None where the expanded model cannot be simulated.
    """
    now, found = _Round.first(base, Expansion.of(base.simulator.space, known, prior)), list[Pruned]()
    sleeping = [d.parameter for d in known if d.asleep and not d.clocked]
    shared, tried = Shared(spikes=(prior.negligible,)), list[list[Response]]()
    for k in range(budget.rounds):
        fit = now.fitted() if k > 0 else now.first_fit(sleeping)
        if fit is None:
            break
        fit = replace(fit, observation=replace(fit.observation, observed=base.observation.observed))
        fits = [fit, *_further(fit, naming)]
        tried = tried or [responses(one) for one in fits]
        off = [discrepancies(one, them) for one, them in zip(fits, tried, strict=False)]
        about = [to_nulls(now.expansion, one) for one in fits]
        problem = linear_gaussian(now.expansion, [*zip(about, map(_columns, off), strict=False)])
        groups, last = groups_of(now.expansion, problem, prior), k >= budget.rounds - budget.pooled
        drawn = sample(problem.H, problem.b, groups, shared, budget.last if last else budget.first, rng)
        found += [_pruned(now.expansion, fit, off[0], drawn, problem)] if last else []
        now = _again(now, fit, off[0], drawn)
        if k == 0:
            spans = likeliest_spans(fit, known)
            now = now.widened(Expansion.of(base.simulator.space, known, prior, spans))
    return _pooled(found) if found else None


def _by_name(
    known: Sequence[Parameter],
    value: Float[np.ndarray, " k"],
    wanted: Sequence[Parameter],
    otherwise: Float[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Values of parameters by their names, and of those that are not known otherwise."""
    of = {p.name: x for p, x in zip(known, value, strict=True)}
    return np.array([of.get(p.name, x) for p, x in zip(wanted, otherwise, strict=True)])


def _columns(here: Sequence[Discrepancy]) -> list[Float[np.ndarray, "q samples"]]:
    return [one.whitened for one in here]


def _further(fit: Fit, naming: Observation | None) -> list[Fit]:
    """The fit in recordings that help to name, if there are any and it can be simulated there."""
    there = [] if naming is None else [elsewhere(fit, naming, apart=True)]
    return [under_own_noise(one) for one in there if np.isfinite(one.at.y[one.simulator.windows.valid]).all()]


def groups_of(expansion: Expansion, problem: LinearGaussian, prior: EffectPrior) -> Groups:
    """Sizes of effects, then discrepancies, with what is believed of them."""
    first = len(expansion.unit)
    widths = np.diff(problem.stop, prepend=first)
    return Groups.of(believed(expansion, widths.tolist(), prior), first - len(expansion.sizes))


def _theta(expansion: Expansion, coefficient: Float[np.ndarray, "n columns"]) -> Float[np.ndarray, "n d"]:
    """Coefficients, in the order of the columns, as parameters, which may lie beyond their boxes."""
    c = np.empty((len(coefficient), len(expansion.unit)))
    c[:, order(expansion)] = coefficient[:, : c.shape[1]]
    return expansion.theta(c)


def folded(
    theta: Float[np.ndarray, "n d"], low: Float[np.ndarray, " d"], high: Float[np.ndarray, " d"]
) -> Float[np.ndarray, "n d"]:
    """What lies beyond a bound, as far within it, so that it keeps its spread: cut off, it would pile up at the bound
    and look sure, where it tells that the model is wrong."""
    mirrored = np.where(theta < low, 2.0 * low - theta, np.where(theta > high, 2.0 * high - theta, theta))
    return np.clip(mirrored, low, high)


def _pruned(
    expansion: Expansion, fit: Fit, here: Sequence[Discrepancy], drawn: Sampled, problem: LinearGaussian
) -> Pruned:
    named, first, shows = len(expansion.groups), len(expansion.unit), showing(expansion, problem)
    included = np.repeat(drawn.included[:, :named], expansion.groups, axis=1)
    discrepant = drawn.included[:, named:] & (drawn.amplitude[:, named:] >= plain_from(expansion, problem))
    left = remainders(fit, here, drawn.coefficient[:, first:], discrepant)
    theta, space = _theta(expansion, drawn.coefficient), expansion.space
    beyond = ((theta < space.low) | (theta > space.high)).mean(axis=0)
    return Pruned(expansion, folded(theta, space.low, space.high), included, discrepant, beyond, shows, fit, left)


def _again(now: _Round, fit: Fit, here: Sequence[Discrepancy], drawn: Sampled) -> _Round:
    """Where to fit next, how strongly to shrink, and what was recorded less the discrepancy that was found."""
    expansion, x = now.expansion, drawn.coefficient
    first = len(expansion.unit)
    rms = np.maximum(np.sqrt(np.mean(x[:, first - len(expansion.sizes) : first] ** 2, axis=0)), LEAST_RMS)
    mean, series = x.mean(axis=0, keepdims=True), np.zeros_like(fit.at.y)
    for one, (c,) in zip(here, parts(mean[:, first:], here), strict=True):
        series += np.tensordot(c, one.series, axes=1)
    observed = np.where(fit.simulator.windows.valid, fit.observation.observed - series, 0.0)
    observation, space = replace(fit.observation, observed=observed), expansion.space
    shrunk = replace(fit, observation=observation, shrinkage=Shrinkage(expansion.rest, expansion.precision(rms)))
    start = _likeliest_before(shrunk, np.clip(_theta(expansion, mean)[0], space.low, space.high))
    return _Round(expansion, start, rms, observation)


def _likeliest_before(fit: Fit, theta: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """The likeliest of some points on the way from a fit to theta, which first order promises more of than is true."""
    points = fit.theta + np.array([*SHARES, 0.0])[:, None] * (theta - fit.theta)
    return points[int(np.argmin(fit.costs(points, fit.simulator.noise_free(points))))]


def _pooled(found: Sequence[Pruned]) -> Pruned:
    """Draws of several rounds together."""
    theta, included, discrepant = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("theta", "included", "discrepant")
    )
    beyond = np.mean([one.beyond for one in found], axis=0)
    return replace(found[-1], theta=theta, included=included, discrepant=discrepant, beyond=beyond)
