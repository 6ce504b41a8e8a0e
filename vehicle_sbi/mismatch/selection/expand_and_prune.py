"""Expand and prune: which effects are missing and what the base parameters are, whatever else is missing.

The model with every effect in is made linear about a fit; which of its columns are needed, and how large they are, is
sampled (`inclusion`). What was found says where to fit again, and how strongly to shrink: an effect that is out is held
to its null, the discrepancy that was found is taken off what was recorded. Draws of the last rounds are pooled, since
none of their linear models is the right one.

The first rounds are annealed (Kirkpatrick et al. 1983): noise is many times the sensors', and falls to theirs. So an
effect comes in once what is larger has been fitted, and each linear model is one about a fit with few effects, as the
truth is. One about a fit with all of them in, each a little, is wrong by tens of units of log likelihood about any such
fit, and what it prunes to then depends on that.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.inference.directions import Direction
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.inference.information import TOLD
from vehicle_sbi.mismatch.estimation.elsewhere import elsewhere, under_own_noise
from vehicle_sbi.mismatch.estimation.expansion import WIDER, Expansion, under_white
from vehicle_sbi.mismatch.estimation.fit import SHARES, Fit, Shrinkage
from vehicle_sbi.mismatch.estimation.linear_gaussian import (
    LinearGaussian,
    beyond_base,
    linear_gaussian,
    order,
    origin,
    showing,
)
from vehicle_sbi.mismatch.estimation.to_nulls import to_nulls
from vehicle_sbi.mismatch.hypotheses.dictionary import believed, sources
from vehicle_sbi.mismatch.hypotheses.discrepancy import Discrepancy, Source, parts, remainders
from vehicle_sbi.mismatch.hypotheses.spans import likeliest_spans
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection import ahead
from vehicle_sbi.mismatch.selection.inclusion import Chain, Groups, Sampled, Shared, sample
from vehicle_sbi.mismatch.selection.pruned import Pruned, folded, pooled
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import TYRE_CURVES

LEAST_RMS = 0.02  # typical sizes, within which an effect that is out is held
PRESENT = 0.3  # typical sizes at root mean square, from which an effect counts as there when curves are tried


@dataclass(frozen=True, kw_only=True)
class Budget:
    """Rounds of fit and sampling: those under white noise that is so many times the sensors', and how many under the
    noise that the fit leaves over; from which of the last ones draws are pooled, and the chains of those and of the
    ones before, which only say where to fit again."""

    annealed: tuple[float, ...] = (16.0, 8.0, 4.0, 2.0)
    rounds: int = 3
    pooled: int = 2
    first: Chain = field(default_factory=lambda: Chain(chains=2, sweeps=120, forgotten=40, every=2))
    last: Chain = field(default_factory=lambda: Chain(chains=2, sweeps=240, forgotten=80, every=2))


BUDGET = Budget()


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
        return cls(expansion, start, np.full(len(expansion.sizes), LEAST_RMS), expansion.observed(base))

    def eased(self, factor: float) -> Fit | None:
        return self.expansion.eased(self.observation, self.start, self.rms, factor)

    def fitted(self) -> Fit | None:
        return self.expansion.fitted(self.observation, self.start, self.rms)

    def bent(self) -> "_Round":
        """From the likeliest of the curves that tyres may have, if they bend at all: each alone in the place of the
        mixture, with the effects that are there. It may be likelier than any mixture on the way to it."""
        expansion, names = self.expansion, [p.name for p in self.expansion.sizes]
        curves = np.array([names.index(name) for name in TYRE_CURVES if name in names], dtype=np.int64)
        there = self.rms > PRESENT
        if len(curves) < 2 or not there[curves].any():
            return self
        there[curves] = True
        rms = np.where(np.isin(np.arange(len(names)), curves), np.maximum(self.rms, WIDER), self.rms)
        small = expansion.only([*itertools.compress(names, there)])
        free, points = small.space.parameters, [self.start, *expansion.alone(self.start, curves)]
        starts = [_by_name(expansion.space.parameters, theta, free, small.rest) for theta in points]
        fit = small.likelier(self.observation.freeing(free), rms[there], starts)
        if fit is None:
            return self
        return replace(self, start=_by_name(free, fit.theta, expansion.space.parameters, self.start), rms=rms)

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
    expansion, told = Expansion.of(base.simulator.space, known, prior), list[_Told]()
    now = _annealed(_Round.first(base, expansion), prior, rng, budget)
    fit = now.fitted()
    if fit is None:
        return None
    asked = _Asked.about(fit, base.observation.observed, naming, prior, rng)
    for k in range(budget.rounds):
        last = k >= budget.rounds - budget.pooled
        one = asked.told(now, fit, budget.last if last else budget.first)
        told += [one] if last else []
        if k + 1 == budget.rounds:
            break
        now = one.again(one.without_discrepancy)
        if k == 0:
            now = now.widened(Expansion.of(base.simulator.space, known, prior, likeliest_spans(one.fit, known)))
        fit = now.fitted()
        if fit is None:
            break
    return pooled([one.pruned for one in told]) if told else None


def _annealed(now: _Round, prior: EffectPrior, rng: np.random.Generator, budget: Budget) -> _Round:
    """Where the first round under the fit's own noise begins, led as far as the model can be simulated.

    What is found of discrepancies stays in what was recorded: under much noise they take what effects will.
    """
    recorded, asked = now.observation, None
    for factor in budget.annealed:
        fit = now.eased(factor)
        if fit is None:
            break
        asked = asked or _Asked.about(fit, recorded.observed, None, prior, rng)
        now = asked.told(now, fit, budget.first).again(recorded)
    return replace(now, observation=under_white(recorded, 1.0)).bent()


@dataclass(frozen=True)
class _Told:
    """What a linearisation tells: about which fit, with the columns of its discrepancies, and what was drawn."""

    now: _Round
    fit: Fit
    off: list[Discrepancy]
    problem: LinearGaussian
    drawn: Sampled

    @property
    def pruned(self) -> Pruned:
        """What was drawn, as parameters within their boxes, effects and discrepancies.

        Of discrepancies counts what is found of them, the mean given the levels: a draw of forty columns that little is
        known of has a signal-to-noise ratio above 4 by itself.
        """
        expansion, drawn, space = self.now.expansion, self.drawn, self.now.expansion.space
        named, first = len(expansion.groups), len(expansion.unit)
        included = np.repeat(drawn.included[:, :named], expansion.groups, axis=1)
        discrepant = drawn.included[:, named:] & (beyond_base(expansion, self.problem, drawn.mean) >= TOLD)
        left = remainders(self.fit, self.off, drawn.coefficient[:, first:], discrepant)
        unexplained = np.asarray(discrepant.any(axis=1))
        theta, shows = _theta(expansion, drawn.coefficient), showing(expansion, self.problem)
        beyond = np.stack([(theta < space.low).mean(axis=0), (theta > space.high).mean(axis=0)])
        within = folded(theta, space.low, space.high)
        return Pruned(expansion, within, included, unexplained, beyond, shows, self.fit, left)

    @property
    def without_discrepancy(self) -> Observation:
        """What was recorded less the discrepancy that was found, under the fit's noise."""
        fit, first = self.fit, len(self.now.expansion.unit)
        mean, series = self.drawn.coefficient.mean(axis=0, keepdims=True), np.zeros_like(fit.at.y)
        for one, (c,) in zip(self.off, parts(mean[:, first:], self.off), strict=True):
            series += np.tensordot(c, one.series, axes=1)
        observed = np.where(fit.simulator.windows.valid, fit.observation.observed - series, 0.0)
        return replace(fit.observation, observed=observed)

    def again(self, observation: Observation) -> _Round:
        """Where to fit this next, and how strongly to shrink."""
        expansion, fit, x = self.now.expansion, self.fit, self.drawn.coefficient
        first = len(expansion.unit)
        rms = np.maximum(np.sqrt(np.mean(x[:, first - len(expansion.sizes) : first] ** 2, axis=0)), LEAST_RMS)
        shrunk = replace(fit, observation=observation, shrinkage=Shrinkage(expansion.rest, expansion.precision(rms)))
        mean, space = x.mean(axis=0, keepdims=True), expansion.space
        start = _likeliest_before(shrunk, np.clip(_theta(expansion, mean)[0], space.low, space.high))
        return _Round(expansion, start, rms, observation)


@dataclass(frozen=True)
class _Asked:
    """What all linearisations are asked with: what was recorded, what the discrepancies do to each recording (they
    hardly depend on the fit), recordings that help to name, and what is believed."""

    observed: Float[np.ndarray, "channels time"]
    sources: list[list[Source]]
    naming: Observation | None
    prior: EffectPrior
    rng: np.random.Generator

    @classmethod
    def about(
        cls,
        fit: Fit,
        observed: Float[np.ndarray, "channels time"],
        naming: Observation | None,
        prior: EffectPrior,
        rng: np.random.Generator,
    ) -> "_Asked":
        return cls(observed, [sources(one) for one in (fit, *_further(fit, naming))], naming, prior, rng)

    def told(self, now: _Round, fit: Fit, chain: Chain) -> _Told:
        """What the linear model about a fit tells."""
        fit = replace(fit, observation=replace(fit.observation, observed=self.observed))
        fits, expansion = [fit, *_further(fit, self.naming)], now.expansion
        off = [[it.about(one) for it in them] for one, them in zip(fits, self.sources, strict=False)]
        about = to_nulls(expansion, fits)
        problem = linear_gaussian(expansion, [*zip(about, map(_columns, off), strict=False)])
        groups = groups_of(expansion, [*itertools.chain(*off)], self.prior)
        ahead.wait()
        drawn = sample(problem.H, problem.b, groups, Shared(), chain, self.rng)
        return _Told(now, fit, off[0], problem, drawn.about(origin(expansion, fit.theta)))


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


def groups_of(expansion: Expansion, off: Sequence[Discrepancy], prior: EffectPrior) -> Groups:
    """Sizes of effects, then discrepancies, with what is believed of them and of the base parameters."""
    own, space = len(expansion.base), expansion.space
    return Groups.of(
        believed(expansion, off, prior),
        np.pad(expansion.shaped, ((0, 0), (0, len(off)))),  # of discrepancies there are none
        low=expansion.coefficients(space.low)[:own],
        high=expansion.coefficients(space.high)[:own],
        outside=prior.outside,
    )


def _theta(expansion: Expansion, coefficient: Float[np.ndarray, "n columns"]) -> Float[np.ndarray, "n d"]:
    """Coefficients, in the order of the columns, as parameters, which may lie beyond their boxes."""
    c = np.empty((len(coefficient), len(expansion.unit)))
    c[:, order(expansion)] = coefficient[:, : c.shape[1]]
    return expansion.theta(c)


def _likeliest_before(fit: Fit, theta: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """The likeliest of some points on the way from a fit to theta, which first order promises more of than is true."""
    points = fit.theta + np.array([*SHARES, 0.0])[:, None] * (theta - fit.theta)
    return points[int(np.argmin(fit.costs(points, fit.simulator.noise_free(points))))]
