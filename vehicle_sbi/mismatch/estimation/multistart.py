"""The likeliest of many fits: from several starts, and with what comes late, begins or ends at the best of many times.

Gauss-Newton stops at the first optimum that it comes to. A series that is linear between samples has a kink in its
derivative by a dead time at every whole sample, and a rough one (acceleration from a measured speed) an optimum near
each; something that begins and ends has one near each place in the recording that it may begin or end at.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.errors import InputError
from vehicle_sbi.mismatch.estimation.fit import MOST_STEPS, Fit, descend, with_own_noise
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.physics.effects import DEAD_TIMES
from vehicle_sbi.threads import each

MOST_DEAD_TIMES = 250  # that are tried of one
REACHES_S = (1.5, 0.3)  # [s] within which the beginning and the end of something are moved, in turn
FINENESS = 5  # steps of them to either side
NEAR, SAME = 12.0, 0.1  # log likelihood by which a fit may promise less than the best, and two fits are one


def best(observation: Observation, starts: Float[np.ndarray, "n d"]) -> Fit:
    """The likeliest of the fits from several starts, under independent noise first and then under its own.

    Raises InputError where the simulation fails at every start.
    """
    simulator = observation.simulator
    white = simulator.with_noise(replace(simulator.noise, rho=np.zeros_like(simulator.noise.rho)))
    first = observation.extended(white if observation.estimated else simulator)
    fit = likeliest(first, [*starts])
    if fit is None:
        raise InputError("the simulation fails wherever a fit was tried; narrow the prior")
    return with_own_noise(fit)


def likeliest(
    observation: Observation, starts: Sequence[Float[np.ndarray, " d"]], steps: int = MOST_STEPS
) -> Fit | None:
    """The best optimum that Gauss-Newton finds from some starts, at other times too, if that is likelier."""
    found = each(lambda start: descend(observation, start, steps), starts)
    fits = each(lambda fit: _in_time(fit, steps), _promising([fit for fit in found if fit is not None]))
    return max(fits, key=lambda fit: fit.log_likelihood, default=None)


def _promising(fits: Sequence[Fit]) -> list[Fit]:
    """Of several fits those that may be the likeliest at other times: at first order they come near the best there. Two
    that are as likely are one."""
    different: list[Fit] = []
    for fit in sorted(fits, key=lambda fit: -fit.log_likelihood):
        if not different or fit.log_likelihood < different[-1].log_likelihood - SAME:
            different.append(fit)
    if len(different) < 2:
        return different
    promise = [_at_best_time(fit) for fit in different]
    return [fit for fit, one in zip(different, promise, strict=True) if one > max(promise) - NEAR]


def _at_best_time(fit: Fit) -> float:
    """Log likelihood, up to the noise's constant, with what begins and ends anywhere within reach, at first order."""
    left = [_best_of(fit, *_moved(fit, *places, REACHES_S[0]))[1] for places in _spans(fit)]
    return -0.5 * min(left, default=float(np.sum(fit.metric(fit.residual) ** 2)))


def _spans(fit: Fit) -> list[tuple[int, int]]:
    """Places of the parameters that say when something begins and how long it lasts."""
    names = fit.simulator.space.names
    lasts = [name.replace(".start", ".duration") for name in names]
    return [(k, names.index(one)) for k, one in enumerate(lasts) if one != names[k] and one in names]


def _in_time(fit: Fit, steps: int) -> Fit:
    """The optimum with what is late, and what begins and ends, at the best of many times."""
    for k, name in enumerate(fit.simulator.space.names):
        if name in DEAD_TIMES:
            fit = _likelier(fit, delayed(fit, k), steps)
    for start, duration in _spans(fit):
        for reach in REACHES_S:
            fit = _likelier(fit, begun(fit, start, duration, reach), steps)
    return fit


def _likelier(fit: Fit, theta: Float[np.ndarray, " d"], steps: int) -> Fit:
    """The optimum from `theta`, if it is likelier than the fit."""
    moved = descend(fit.observation, theta, steps)
    return moved if moved is not None and moved.log_likelihood > fit.log_likelihood else fit


def delayed(fit: Fit, k: int) -> Float[np.ndarray, " d"]:
    """theta with dead time k where in its box the model fits best, the other parameters following at first order.

    What is tried lies between whole samples, at which there are kinks.
    """
    space = fit.simulator.space
    step = max(0.5 / fit.simulator.windows.rate, (space.high[k] - space.low[k]) / MOST_DEAD_TIMES)
    return _best_of(fit, [k], np.arange(space.low[k] + 0.5 * step, space.high[k], step)[:, None])[0]


def begun(fit: Fit, start: int, duration: int, reach: float) -> Float[np.ndarray, " d"]:
    """theta with the span of what begins and lasts where the model fits best, within a reach [s] of where it is now."""
    return _best_of(fit, *_moved(fit, start, duration, reach))[0]


def _moved(fit: Fit, start: int, duration: int, reach: float) -> tuple[list[int], Float[np.ndarray, "n 2"]]:
    """The places of a span, and what may stand there within a reach [s] of what does."""
    space, places = fit.simulator.space, [start, duration]
    begins, lasts = fit.theta[places]
    moves = np.linspace(-reach, reach, 2 * FINENESS + 1)
    first, last = np.meshgrid(begins + moves, begins + lasts + moves, indexing="ij")
    tried = np.stack([first.ravel(), (last - first).ravel()], axis=-1)
    within = (tried >= space.low[places]) & (tried <= space.high[places]) & (tried[:, 1:] > 0.0)
    return places, np.concatenate([fit.theta[None, places], tried[within.all(axis=1)]])


def _best_of(
    fit: Fit, places: Sequence[int], tried: Float[np.ndarray, "n places"]
) -> tuple[Float[np.ndarray, " d"], float]:
    """theta with those values in some places at which the model fits best, the others following at first order, and the
    sum of squares that it leaves over."""
    points = np.repeat(fit.theta[None], len(tried), axis=0)
    points[:, places] = tried
    off = np.where(fit.simulator.windows.valid, fit.observation.observed - fit.simulator.noise_free(points), 0.0)
    r = fit.metric(np.nan_to_num(off)).reshape(len(tried), -1)
    others = np.delete(fit.white, places, axis=0)
    followed, _ = np.linalg.qr(others.T)
    left = np.sum(r**2, axis=1) - np.sum((r @ followed) ** 2, axis=1)
    left = np.where(np.isfinite(off).all(axis=(1, 2)), left, np.inf)
    return points[int(np.argmin(left))], float(left.min())
