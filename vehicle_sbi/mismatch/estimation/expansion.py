"""The model expanded: the base model's parameters and those of every effect that acts, all free at once.

Effects are shrunk to their nulls by normal priors as wide as cars are said to need (`EffectPrior`). A parameter that
only gives an effect its shape (a lag, a lever arm) is free beside its size. What comes and goes (a gust) enters once
its likeliest span is known, with its beginning and duration free within a tile of the recordings' time.
"""

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from vehicle_sbi.inference.directions import Direction, middle, null
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.inference.setup import slowest, steps_at
from vehicle_sbi.mismatch.estimation.fit import Fit, Shrinkage, descend, onwards, relinearised, with_own_noise
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.threads import each

WIDER = 1.5  # typical sizes by which effects are shrunk at first, before anything is known of which are there
FIRST_STEPS = 6  # of Gauss-Newton from each start near the optimum, before the best goes on
EASED = (32.0, 16.0, 8.0, 4.0, 2.0, 1.0)  # times the sensors' noise under which a far start is led to the optimum
EASED_STEPS = 4  # of Gauss-Newton under each of them
ANEW = 2  # of those noises after which derivatives are simulated anew rather than follow from steps
STEPS, NOISE_ROUNDS, NOISE_STEPS = 16, 2, 8  # of Gauss-Newton, of fit and noise, and of Gauss-Newton within those
LAST_STEPS = 6  # of Gauss-Newton, before a model is made linear
STIRRED = 0.1  # typical sizes off its null, from which what sleeps there does not any more
STIFFER = 1.4  # times the fitted stiffness, for which steps of the integrator are short enough
FARTHEST = 20.0  # logarithm of a ratio at most, against overflow
STABLE = 2.0  # step times rate at most


@dataclass(frozen=True)
class Expansion:
    """What is free in the expanded model: `base`, then `sizes` along which effects leave their nulls, then `shapes`.

    `typical` are the sizes' typical distances from null, `rates` how often cars have them, both in the sizes' order; of
    what comes and goes, how often in its span. `asleep` names the sizes that change next to nothing near their nulls.
    """

    base: tuple[Parameter, ...]
    sizes: tuple[Parameter, ...]
    shapes: tuple[Parameter, ...]
    typical: Float[np.ndarray, " sizes"]
    rates: Float[np.ndarray, " sizes"]
    asleep: tuple[str, ...] = ()

    @classmethod
    def of(
        cls, space: ParameterSpace, known: Sequence[Direction], prior: EffectPrior, spans: Sequence[Direction] = ()
    ) -> "Expansion":
        """Of the effects that are known to act all the time, and of those that come and go in these spans."""
        acting = [*(d for d in known if not d.clocked), *spans]
        sizes = [*dict.fromkeys(d.parameter for d in acting)]
        shapes = [*dict.fromkeys(p for d in acting for p in d.held if p not in sizes)]
        share = {d.parameter: d.share for d in acting}
        typical, rates = ([prior.size_of(p) for p in sizes], [prior.rate_of(p) * share[p] for p in sizes])
        asleep = dict.fromkeys(d.parameter.name for d in acting if d.asleep and not d.clocked)
        return cls(space.parameters, tuple(sizes), tuple(shapes), np.array(typical), np.array(rates), tuple(asleep))

    @property
    def space(self) -> ParameterSpace:
        return ParameterSpace((*self.base, *self.sizes, *self.shapes))

    @property
    def rest(self) -> Float[np.ndarray, " d"]:
        """Where the linear model's coefficients are zero: the middle of the base model's boxes, effects at their nulls,
        shapes in the middle of boxes that begin or end at their nulls and at their nulls in others."""
        return np.array([*map(_middle, self.base), *map(null, self.sizes), *map(_neutral, self.shapes)])

    @property
    def unit(self) -> Float[np.ndarray, " d"]:
        """What a coefficient of 1 is near `rest`: a standard deviation of the box, of sizes their typical distance."""
        return np.concatenate([_spread(self.base), self.typical, _spread(self.shapes)])

    @property
    def ratio(self) -> Bool[np.ndarray, " d"]:
        """Which base parameters and sizes can only be positive: stiffnesses, factors and gains, of which products act.
        In logarithms a model is as linear in several of them as in one."""
        return (self.space.low > 0.0) & (np.arange(len(self.space)) < len(self.base) + len(self.sizes))

    def coefficients(self, theta: Float[np.ndarray, "*n d"]) -> Float[np.ndarray, "*n d"]:
        """Where theta is in units of what is believed, from `rest` on; logarithms of what can only be positive."""
        one = np.where(self.ratio, self.rest, 1.0)
        step = np.where(self.ratio, one * np.log(np.where(self.ratio, theta / one, 1.0)), theta - self.rest)
        return step / self.unit

    def theta(self, coefficients: Float[np.ndarray, "*n d"]) -> Float[np.ndarray, "*n d"]:
        """Parameters that have such coefficients, which may lie beyond their boxes: the linear model has none."""
        one, step = np.where(self.ratio, self.rest, 1.0), self.unit * coefficients
        grown = one * np.exp(np.clip(step / one, -FARTHEST, FARTHEST))
        return np.where(self.ratio, grown, self.rest + step)

    def slope(self, theta: Float[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
        """By how much parameters grow with their coefficients."""
        return self.unit * np.where(self.ratio, theta / np.where(self.ratio, self.rest, 1.0), 1.0)

    @property
    def bounds(self) -> tuple[Float[np.ndarray, " sizes"], Float[np.ndarray, " sizes"]]:
        """Coefficients of sizes at the ends of their boxes, which enclose 0 or begin or end there."""
        sizes = slice(len(self.base), len(self.base) + len(self.sizes))
        low, high = (self.coefficients(end)[sizes] for end in (self.space.low, self.space.high))
        return np.minimum(low, 0.0), np.maximum(high, 0.0)

    @property
    def reach(self) -> Float[np.ndarray, " sizes"]:
        """How far sizes can be from their nulls within their boxes, in coefficients."""
        return np.max(np.abs(self.bounds), axis=0)

    @property
    def shaping(self) -> Bool[np.ndarray, " d"]:
        """Which parameters give effects their shapes, and so change nothing where those are not missing."""
        return np.arange(len(self.space)) >= len(self.base) + len(self.sizes)

    @property
    def shaped(self) -> Bool[np.ndarray, "shapes groups"]:
        """Which groups of sizes are of the effect that each shape is of."""
        firsts = np.cumsum([0, *self.groups[:-1]])
        of = np.array([_effect(self.sizes[k]) for k in firsts], dtype=object)
        return np.array([of == _effect(p) for p in self.shapes], dtype=bool).reshape(len(self.shapes), len(of))

    @property
    def groups(self) -> list[int]:
        """How many neighbouring sizes are missing together: those of a profile over time, any other by itself."""
        of = [p.name.rstrip("0123456789") for p in self.sizes]
        return [len([*same]) for _, same in itertools.groupby(of)]

    @property
    def probabilities(self) -> dict[str, float]:
        """How often cars have each effect, by any of its sizes; those of a profile over time are missing together."""
        firsts, spared = np.cumsum([0, *self.groups[:-1]]), dict[str, float]()
        for first in firsts:
            effect = _effect(self.sizes[first])
            spared[effect] = spared.get(effect, 1.0) * (1.0 - float(self.rates[first]))
        return {effect: 1.0 - none for effect, none in spared.items()}

    def only(self, sizes: Collection[str]) -> "Expansion":
        """With some of the sizes alone, and the shapes of their effects."""
        kept = np.array([p.name in sizes for p in self.sizes], dtype=bool)
        effects = {name.split(".")[0] for name in sizes}
        shapes = tuple(p for p in self.shapes if _effect(p) in effects)
        return replace(
            self,
            sizes=tuple(itertools.compress(self.sizes, kept)),
            shapes=shapes,
            typical=self.typical[kept],
            rates=self.rates[kept],
            asleep=tuple(name for name in self.asleep if name in sizes),
        )

    def precision(self, rms: Float[np.ndarray, " sizes"]) -> Float[np.ndarray, " d"]:
        """Of the shrinkage that holds sizes within `rms` typical ones, in units of the boxes' standard deviations.

        Base parameters and shapes are as likely within their boxes as the linear model believes. Without that, a fit
        slides to a bound along what can hardly be told apart (a centre of gravity and an IMU that both are elsewhere),
        where the linear model holds least.
        """
        held = (rms * self.typical / _spread(self.sizes)) ** -2
        return np.concatenate([np.ones(len(self.base)), held, np.ones(len(self.shapes))])

    def observed(self, base: Fit) -> Observation:
        """What the base model was fitted to, with all of this free, in steps as long as the fit allows."""
        simulator = base.simulator
        lighter = replace(simulator, substeps=np.minimum(simulator.substeps, _substeps(base)))
        return base.observation.extended(lighter).freeing(self.space.parameters)

    def fitted(
        self, observation: Observation, start: Float[np.ndarray, " d"], rms: Float[np.ndarray, " sizes"]
    ) -> Fit | None:
        """The likeliest point under shrinkage near a start that is close to it; None where the simulation fails.

        Derivatives follow from steps, and are simulated at both ends and after each of the last steps.
        """
        fit = self._descended(observation, start, rms, STEPS)
        if fit is None:
            return None
        fit = with_own_noise(fit, NOISE_ROUNDS, NOISE_STEPS, secant=True)
        fit = onwards(relinearised(fit, fit.theta), LAST_STEPS)
        return relinearised(fit, fit.theta)

    def eased(
        self,
        observation: Observation,
        start: Float[np.ndarray, " d"],
        rms: Float[np.ndarray, " sizes"],
        factor: float,
    ) -> Fit | None:
        """The same under white noise that is so many times the sensors', where what sleeps may be anywhere; where it
        still does, from there as well with that halfway into its boxes."""
        held, own = np.where(self._sleeping, WIDER, rms), len(self.base)
        off = np.abs(self.coefficients(start)[own : own + len(self.sizes)]) > STIRRED
        asleep = np.flatnonzero(self._sleeping & ~off)
        starts = [start, self._awake(start, asleep)] if len(asleep) else [start]
        best = _likeliest(each(lambda one: self._led(observation, held, one, (factor,), LAST_STEPS), starts))
        return None if best is None else relinearised(best, best.theta)

    @property
    def _sleeping(self) -> Bool[np.ndarray, " sizes"]:
        """Which sizes change next to nothing near their nulls."""
        return np.array([p.name in self.asleep for p in self.sizes], dtype=bool)

    def _awake(self, theta: Float[np.ndarray, " d"], sizes: Int[np.ndarray, " k"]) -> Float[np.ndarray, " d"]:
        """With some sizes halfway into their boxes."""
        awake = theta.copy()
        awake[len(self.base) + sizes] = [middle(self.sizes[k]) for k in sizes]
        return awake

    def likeliest(
        self,
        observation: Observation,
        rms: Float[np.ndarray, " sizes"],
        *,
        near: Sequence[Float[np.ndarray, " d"]] = (),
        far: Sequence[Float[np.ndarray, " d"]] = (),
    ) -> Fit | None:
        """The likeliest point under shrinkage from several starts; None where the simulation fails at all of them.

        Those that are `far` are led there under noise that falls to that of the sensors: what is small is fitted only
        once what is large is, with no more off its null than that takes. Under the sensors' noise from the first step
        on most of them end in optima that are hundreds of units of log likelihood lower. The best goes on, in the end
        with derivatives that are simulated after every step: those that follow from steps often end in a valley, tens
        of units below its bottom.
        """
        ways = [*((start, (1.0,), FIRST_STEPS) for start in near), *((start, EASED, EASED_STEPS) for start in far)]
        best = _likeliest(each(lambda way: self._led(observation, rms, *way), ways))
        if best is None:
            return None
        best = replace(onwards(best, STEPS, secant=True), observation=observation)
        best = with_own_noise(best, NOISE_ROUNDS, NOISE_STEPS, secant=True)
        best = with_own_noise(onwards(relinearised(best, best.theta), STEPS), NOISE_ROUNDS, NOISE_STEPS)
        return relinearised(best, best.theta)

    def likelier(
        self,
        observation: Observation,
        rms: Float[np.ndarray, " sizes"],
        starts: Sequence[Float[np.ndarray, " d"]],
    ) -> Fit | None:
        """Where a few steps from the best of some starts lead; None where the simulation fails at all of them."""
        return _likeliest(each(lambda start: self._led(observation, rms, start, (1.0,), FIRST_STEPS), starts))

    def alone(self, theta: Float[np.ndarray, " d"], sizes: Int[np.ndarray, " k"]) -> list[Float[np.ndarray, " d"]]:
        """Points with one of some sizes each, as large as effects are shrunk to at first, in the place of all."""
        c, own = self.coefficients(theta), len(self.base) + sizes
        sign = np.where(c[own].sum() < 0.0, -1.0, 1.0)
        alone = np.tile(np.where(np.isin(np.arange(len(c)), own), 0.0, c), (len(own), 1))
        alone[np.arange(len(own)), own] = sign * WIDER
        return [*np.clip(self.theta(alone), self.space.low, self.space.high)]

    def _led(
        self,
        observation: Observation,
        rms: Float[np.ndarray, " sizes"],
        start: Float[np.ndarray, " d"],
        way: Sequence[float],
        steps: int,
    ) -> Fit | None:
        """So many steps under white noise that is so many times the sensors', one after another.

        What parameters do is the same under any noise, so derivatives are kept from one to the next.
        """
        fit = None
        for k, factor in enumerate(way):
            under = under_white(observation, factor)
            if fit is not None and k % ANEW:
                fit = onwards(replace(fit, observation=under), steps, secant=True, renewed=False)
            else:
                fit = self._descended(under, start if fit is None else fit.theta, rms, steps)
            if fit is None:
                return None
        return fit

    def _descended(
        self, observation: Observation, start: Float[np.ndarray, " d"], rms: Float[np.ndarray, " sizes"], steps: int
    ) -> Fit | None:
        """As far as so many steps go, with derivatives that follow from them."""
        space, pull = observation.simulator.space, Shrinkage(self.rest, self.precision(rms))
        start = np.clip(start, space.low, space.high)
        return descend(observation, start, steps, pull, secant=True, renewed=False)


def under_white(observation: Observation, factor: float) -> Observation:
    """Under white noise that is so many times the sensors'."""
    noise = observation.simulator.noise.of_sensor
    white = replace(noise, floor=factor * noise.floor, rho=np.zeros_like(noise.rho))
    return observation.extended(observation.simulator.with_noise(white))


def _likeliest(led: Sequence[Fit | None]) -> Fit | None:
    """Under its shrinkage, of those that could be simulated; None if none could."""
    return max((fit for fit in led if fit is not None), key=_log_posterior, default=None)


def _log_posterior(fit: Fit) -> float:
    return fit.log_likelihood - float(fit.pulled(fit.theta[None])[0])


def _substeps(fit: Fit) -> Int[np.ndarray, " windows"]:
    """Of the integrator, for stiffnesses a little above those that were fitted."""
    simulator, space = fit.simulator, fit.simulator.space
    stiff = np.array([p.name.startswith("C_") for p in space.parameters])
    theta = np.clip(np.where(stiff, STIFFER, 1.0) * fit.theta, space.low, space.high)
    return steps_at(simulator, theta[None], slowest(simulator, fit.theta[None])[0], STABLE)


def _effect(p: Parameter) -> str:
    return p.name.split(".")[0]


def _middle(p: Parameter) -> float:
    return 0.5 * (p.low + p.high)


def _neutral(p: Parameter) -> float:
    return null(p) if p.low < null(p) < p.high else _middle(p)


def _spread(parameters: Sequence[Parameter]) -> Float[np.ndarray, " n"]:
    """Standard deviations of uniform boxes."""
    return np.array([p.high - p.low for p in parameters]) / np.sqrt(12.0)
