"""Expand and prune: which effects are missing and what the base parameters are, whatever else is missing.

The model with every effect in is fitted under shrinkage, and made linear there; which of its columns are needed, and
how large they are, is sampled (`inclusion`). What was found says where to fit again, and how strongly to shrink: an
effect that is out is held to its null, the discrepancy that was found is taken off what was recorded. Draws of the
last rounds are pooled, since none of their linear models is the right one.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.inference.directions import Direction
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.estimation.expansion import WIDER, Expansion, elsewhere
from vehicle_sbi.mismatch.estimation.linear_gaussian import LinearGaussian, linear_gaussian, order
from vehicle_sbi.mismatch.fit import Fit, Observation
from vehicle_sbi.mismatch.hypotheses.discrepancy import Discrepancy, discrepancies
from vehicle_sbi.mismatch.selection.inclusion import Chain, Groups, Sampled, Shared, sample

FIRST = Chain(chains=2, sweeps=120, forgotten=40, every=2)  # to say where to fit again
CHAIN = Chain(chains=2, sweeps=240, forgotten=80, every=2)
MOST_READINGS = 40_000  # samples times channels: of more, products of all columns take minutes and gigabytes
LEAST_RMS = 0.02  # typical sizes, within which an effect that is out is held


@dataclass(frozen=True, kw_only=True)
class Belief:
    """How large effects are where they are missing, how large discrepancies, and in how many rounds both are sought.

    `slabs` are standard deviations of a moment prior, in typical sizes, with their `slab_shares`; `amplitudes` are
    those of discrepancies, in the largest sizes of laws, half normal with `discrepancy_scale`; `discrepancy_rate` is
    the probability of each. Rounds from the `pooled`-th last one on count.
    """

    slabs: Sequence[float] = (0.6, 1.5)
    slab_shares: Sequence[float] = (0.85, 0.15)
    amplitudes: Sequence[float] = (0.003, 0.01, 0.03, 0.1, 0.3)
    discrepancy_scale: float = 0.1
    discrepancy_rate: float = 0.9
    none: float = 1e-4  # amplitude that stands for no discrepancy
    odds: float = 1.0  # factor on the odds of all effects' rates
    shared: Shared = field(default_factory=lambda: Shared(spikes=(0.1,)))
    rounds: int = 3
    pooled: int = 2


BELIEF = Belief()


@dataclass(frozen=True)
class Pruned:
    """Draws from the posterior over the expanded model: `theta` (n, d) in the parameters' units, `included` (n, sizes)
    says which sizes are away from their nulls, `discrepant` (n, groups) which discrepancies are there."""

    expansion: Expansion
    theta: Float[np.ndarray, "n d"]
    included: Bool[np.ndarray, "n sizes"]
    discrepant: Bool[np.ndarray, "n groups"]
    fit: Fit

    @property
    def effects(self) -> dict[str, float]:
        """The probability that each effect is missing, whatever else is; the largest first."""
        names = dict.fromkeys(p.name.split(".")[0] for p in self.expansion.sizes)
        found = {name: self.any_of([name]) for name in names}
        return dict(sorted(found.items(), key=lambda one: -one[1]))

    def any_of(self, effects: Collection[str]) -> float:
        """The probability that at least one of some effects is missing."""
        columns = [k for k, p in enumerate(self.expansion.sizes) if p.name.split(".")[0] in effects]
        return float(self.included[:, columns].any(axis=1).mean())

    def draws(self, name: str) -> Float[np.ndarray, " n"]:
        """Of one parameter; of an effect's size, those in which it is missing, if there are any."""
        space = self.fit.simulator.space
        values = self.theta[:, space.column(name)]
        sizes = [p.name for p in self.expansion.sizes]
        chosen = self.included[:, sizes.index(name)] if name in sizes else np.ones(len(values), dtype=bool)
        return values[chosen] if chosen.any() else values


def expand_and_prune(
    base: Fit,
    known: Sequence[Direction],
    naming: Observation | None,
    *,
    prior: EffectPrior,
    rng: np.random.Generator,
    belief: Belief = BELIEF,
    chain: Chain = CHAIN,
) -> Pruned | None:
    """From the base model's fit on, with directions that are known to act and recordings that help to name, if any.

    None where the expanded model cannot be simulated.
    """
    expansion = Expansion.of(base.simulator.space, known, prior)
    whole = expansion.observed(base)
    start = np.concatenate([base.theta, expansion.rest[len(base.theta) :]])
    rms, observation, found = np.full(len(expansion.sizes), WIDER), whole, list[Pruned]()
    for k in range(belief.rounds):
        fit = expansion.fitted(observation, start, rms)
        if fit is None:
            break
        fit = replace(fit, observation=replace(fit.observation, observed=whole.observed))
        here = discrepancies(fit)
        problem = linear_gaussian(expansion, [(fit, here), *_further(fit, naming)])
        last = k >= belief.rounds - belief.pooled
        drawn = sample(
            problem.H, problem.b, groups_of(expansion, problem, belief), belief.shared, chain if last else FIRST, rng
        )
        found += [_pruned(expansion, fit, drawn)] if last else []
        start, rms, observation = _again(expansion, fit, here, drawn)
    return _pooled(found) if found else None


def _further(fit: Fit, naming: Observation | None) -> list[tuple[Fit, Sequence[Discrepancy]]]:
    there = None if naming is None else elsewhere(fit, naming)
    return [] if there is None else [(there, discrepancies(there))]


def groups_of(expansion: Expansion, problem: LinearGaussian, belief: Belief) -> Groups:
    """Each size by itself, then each discrepancy, with what is believed of them."""
    sizes, others = len(expansion.sizes), len(problem.stop)
    start = len(expansion.unit) - sizes
    levels = 1 + max(len(belief.slabs), len(belief.amplitudes))
    amplitude, share = np.zeros((sizes + others, levels)), np.zeros((sizes + others, levels))
    amplitude[:, 0], share[:, 0] = np.repeat([1.0, belief.none], [sizes, others]), 1.0
    amplitude[:sizes, 1 : 1 + len(belief.slabs)], share[:sizes, 1 : 1 + len(belief.slabs)] = (
        belief.slabs,
        belief.slab_shares,
    )
    weight = np.exp(-0.5 * (np.array(belief.amplitudes) / belief.discrepancy_scale) ** 2)
    amplitude[sizes:, 1 : 1 + len(weight)], share[sizes:, 1 : 1 + len(weight)] = (
        belief.amplitudes,
        weight / weight.sum(),
    )
    odds = belief.odds * expansion.rates / (1.0 - expansion.rates)
    sign = np.zeros(len(problem.b), dtype=np.int64)
    sign[start : start + sizes] = expansion.sign
    return Groups(
        start=start,
        stop=np.concatenate([start + 1 + np.arange(sizes), problem.stop]),
        precision=np.ones(start),
        amplitude=amplitude,
        share=share,
        rate=np.concatenate([odds / (1.0 + odds), np.full(others, belief.discrepancy_rate)]),
        named=np.arange(sizes + others) < sizes,
        sign=sign,
    )


def _theta(expansion: Expansion, coefficient: Float[np.ndarray, "n columns"]) -> Float[np.ndarray, "n d"]:
    """Coefficients as parameters, within their boxes."""
    theta = np.empty((len(coefficient), len(expansion.unit)))
    theta[:, order(expansion)] = coefficient[:, : theta.shape[1]]
    space = expansion.space
    return np.clip(expansion.rest + expansion.unit * theta, space.low, space.high)


def _pruned(expansion: Expansion, fit: Fit, drawn: Sampled) -> Pruned:
    sizes = len(expansion.sizes)
    return Pruned(
        expansion, _theta(expansion, drawn.coefficient), drawn.included[:, :sizes], drawn.included[:, sizes:], fit
    )


def _again(
    expansion: Expansion, fit: Fit, here: Sequence[Discrepancy], drawn: Sampled
) -> tuple[Float[np.ndarray, " d"], Float[np.ndarray, " sizes"], Observation]:
    """Where to fit next, how strongly to shrink, and what was recorded less the discrepancy that was found."""
    first = len(expansion.unit)
    x = drawn.coefficient
    rms = np.maximum(np.sqrt(np.mean(x[:, first - len(expansion.sizes) : first] ** 2, axis=0)), LEAST_RMS)
    mean, series = x.mean(axis=0), np.zeros_like(fit.at.y)
    for one in here:
        series += np.tensordot(mean[first : first + len(one.series)], one.series, axes=1)
        first += len(one.series)
    observed = np.where(fit.simulator.windows.valid, fit.observation.observed - series, 0.0)
    return _theta(expansion, mean[None])[0], rms, replace(fit.observation, observed=observed)


def _pooled(found: Sequence[Pruned]) -> Pruned:
    """Draws of several rounds together."""
    theta, included, discrepant = (
        np.concatenate([getattr(one, name) for one in found]) for name in ("theta", "included", "discrepant")
    )
    return Pruned(found[-1].expansion, theta, included, discrepant, found[-1].fit)
