"""The experiment that separates: which further recording would tell apart two explanations that fit equally well.

Both fitted models a and b are simulated over a menu of recordings made from the one that exists: other drives, the same
road the other way, another sensor. In each, with d what they differ by and J what their parameters (in units of the
prior) do there, all in units of the noise, and P what both fits know of their parameters, prior included,

    separation^2 = d'd - d'J (P + J'J)^-1 J'd          d = y_b - y_a,   J = [J_a, -J_b],   P = diag(P_a, P_b)

is how far apart they are after whatever the first recordings leave open has absorbed what it can. It is the distance in
the covariance I + J P^-1 J' of both predictions. All of it follows from simulation.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float
from scipy.linalg import block_diag

from vehicle_sbi.data.channels import CHANNELS, NEEDED
from vehicle_sbi.data.noise import MeasurementNoise
from vehicle_sbi.inference.directions import null
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.elsewhere import elsewhere
from vehicle_sbi.mismatch.estimation.fit import Fit, Linear, Metric, linearise
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS, ONCOMING
from vehicle_sbi.physics.sensors import BODY_MEASUREMENTS, MEASUREMENTS
from vehicle_sbi.physics.single_track import INPUTS

HIDDEN = 2.0  # standard deviations, below which noise may hide that two models differ
WORTH = 3.0  # from which a drive is worth naming, rather than another sensor
SETTLED_S = 2.0  # [s], several times what a car takes to turn as it is steered
WALKING = 1.5  # [m/s], above what readers leave out as too slow for the model
STEERING, SPEED, ACCELERATION = (INPUTS.index(name) for name in ("steering", "v_x", "v_x_dot"))
WHEELS = [INPUTS.index(name) for name in ("wheel_speed_front", "wheel_speed_rear")]
PACED = [SPEED, ACCELERATION, *WHEELS]

# Standard deviations [channel's unit] of the sensors that a production car has, or could be given, at a sample.
SENSORS: Mapping[str, float] = {
    "a_x": 0.15, "a_y": 0.15, "a_z": 0.15, "yaw_rate": 0.005, "roll_rate": 0.005, "pitch_rate": 0.005,
    "wheel_speed_front": 0.1, "wheel_speed_rear": 0.1, "v_x": 0.05, "v_y": 0.05,
}  # fmt: skip

Change = Callable[[Simulator], Simulator]  # from the recordings that exist to a further one


@dataclass(frozen=True)
class Experiment:
    """A recording to make, in words, and by how many standard deviations it would tell two models apart."""

    drive: str
    separation: float


def _driven(simulator: Simulator, u: Float[np.ndarray, "windows time 9"], start: Float[np.ndarray, " 3"]) -> Simulator:
    """With other inputs, which nothing goes before, from so many times the initial states."""
    windows = simulator.windows
    return replace(simulator, windows=replace(windows, u=u, before=windows.before[:, :0], x0=windows.x0 * start))


def _steered(simulator: Simulator, steering: Float[np.ndarray, "windows time"], turning: float) -> Simulator:
    """With another steering [rad], from so many times the initial sideslip and yaw rate."""
    u = simulator.windows.u.copy()
    u[..., STEERING] = steering
    return _driven(simulator, u, np.array([1.0, turning, turning]))


def _mirrored(simulator: Simulator) -> Simulator:
    return _steered(simulator, -simulator.windows.u[..., STEERING], -1.0)


def _straight(simulator: Simulator) -> Simulator:
    return _steered(simulator, np.zeros(simulator.windows.t.shape), 0.0)


def _circle(simulator: Simulator) -> Simulator:
    """A circle that the car has settled into: how it gets there is no part of it."""
    steering = simulator.windows.u[..., STEERING]
    circle = _steered(simulator, np.full(steering.shape, 0.7 * np.abs(steering).max()), 1.0)
    windows, samples = circle.windows, steering.shape[1]
    settled = np.arange(samples) >= min(round(SETTLED_S * windows.rate), samples // 2)
    return replace(circle, windows=replace(windows, valid=windows.valid & np.tile(settled, len(steering))))


def _quicker(simulator: Simulator) -> Simulator:
    """The steering of the first half of each window over and over, twice as fast."""
    fast = simulator.windows.u[:, ::2, STEERING]
    return _steered(simulator, np.concatenate([fast, fast], axis=1)[:, : simulator.windows.t.shape[1]], 1.0)


def _opposite(simulator: Simulator) -> Simulator:
    """Along the same road the other way: curves, slopes and wind have the other sign, the car's own offsets do not."""
    parameters = tuple(_oncoming(p) for p in simulator.space.parameters)
    return replace(_mirrored(simulator), space=ParameterSpace(parameters))


def _oncoming(p: Parameter) -> Parameter:
    """The parameter as it acts on a car that comes the other way."""
    if not ONCOMING.keys() >= {*p.fields}:
        return p
    return replace(p, scale=-p.scale, fields=tuple(ONCOMING[name] for name in p.fields))


def _paced(factor: float) -> Change:
    def change(simulator: Simulator) -> Simulator:
        u = simulator.windows.u.copy()
        u[..., PACED] *= factor
        return _finer(_driven(simulator, u, np.array([factor, 1.0, 1.0])), factor)

    return change


def _walking(simulator: Simulator) -> Simulator:
    """Straight ahead at a walking pace, as near to a standstill as the model holds."""
    u = simulator.windows.u.copy()
    u[..., [STEERING, ACCELERATION]] = 0.0
    u[..., SPEED], u[..., WHEELS] = WALKING, WALKING / simulator.nominal["R_f"]
    x0 = np.tile([WALKING, 0.0, 0.0], (len(u), 1))
    slow = replace(simulator, windows=replace(simulator.windows, u=u, before=simulator.windows.before[:, :0], x0=x0))
    return _finer(slow, WALKING / simulator.windows.x0[:, 0])


def _finer(simulator: Simulator, factor: float | Float[np.ndarray, " windows"]) -> Simulator:
    """With steps that are short enough at so many times the speed: the fastest modes are quicker, the slower it is."""
    steps = np.full(len(simulator.windows.u), simulator.substeps)
    return replace(simulator, substeps=np.ceil(steps / np.minimum(factor, 1.0)).astype(int))


STEERED: Mapping[str, Change] = {
    "the same drive with the steering mirrored": _mirrored,
    "the same speeds straight ahead": _straight,
    "a steady circle at the same speeds": _circle,
    "the same drive with steering twice as fast": _quicker,
    "a second run of the same road in the opposite direction": _opposite,
}
AT_SPEED: Mapping[str, Change] = {  # where the speed is given, rather than what torques make of it
    "the same steering at 0.7 times the speed": _paced(0.7),
    "the same steering at 1.3 times the speed": _paced(1.3),
    f"a stretch straight ahead at walking pace ({WALKING:g} m/s)": _walking,
}
MENU: Mapping[str, Change] = {**STEERED, **AT_SPEED}


def _sensed(channel: str) -> Change:
    """The same drive with a further channel, whose noise is as slow as that of the slowest one recorded."""

    def change(simulator: Simulator) -> Simulator:
        windows, noise = simulator.windows, simulator.noise
        measured = replace(
            windows,
            channels=(*windows.channels, channel),
            groups=(*windows.groups, CHANNELS[channel].group),
            y=np.concatenate([windows.y, np.full_like(windows.y[:1], np.nan)]),
            valid=np.concatenate([windows.valid, windows.valid.any(axis=0, keepdims=True)]),
        )
        more = MeasurementNoise(
            share=np.append(noise.share, 0.0),
            floor=np.append(noise.floor, SENSORS[channel]),
            rho=np.append(noise.rho, noise.rho.max()),
            window=noise.window,
        )
        return replace(simulator, windows=measured).with_noise(more)

    return change


def _unrecorded(simulator: Simulator) -> list[str]:
    """Channels that the model predicts, and that neither drive it nor are recorded."""
    predicted = [name for name in MEASUREMENTS if simulator.model == "full_vehicle" or name not in BODY_MEASUREMENTS]
    return [name for name in predicted if name not in (*simulator.windows.channels, *NEEDED[simulator.drive])]


def menu(simulator: Simulator) -> dict[str, Change]:
    """Recordings that could be made beside those behind a simulator: drives, and the same one with another sensor."""
    drives = STEERED if simulator.drive == "torque" else MENU
    return {**drives, **{f"the same drive with {name} measured too": _sensed(name) for name in _unrecorded(simulator)}}


def separations(a: Model, b: Model) -> list[Experiment]:
    """How well each recording of the menu would tell the models apart, the best first."""
    found = [Experiment(words, separation(a.fit, b.fit, change)) for words, change in menu(a.fit.simulator).items()]
    return sorted((one for one in found if np.isfinite(one.separation)), key=lambda one: -one.separation)


def separation(a: Fit, b: Fit, change: Change) -> float:
    """Standard deviations between models in a further recording; NaN where one of them cannot be simulated there.

    The noise is that of a.
    """
    there = [change(fit.simulator) for fit in (a, b)]
    at_a = linearise(there[0], _later(a))
    return _apart((a, b), there[0], at_a, linearise(there[1], _later(b), at_a.J_x))


def separation_in(a: Fit, b: Fit, held_out: Observation) -> float:
    """The same in recordings that exist and were held out, in which what is tied to the clock did not happen."""
    there = [elsewhere(fit, held_out, apart=True) for fit in (a, b)]
    return _apart((a, b), there[0].simulator, *(fit.at for fit in there))


def _apart(fits: tuple[Fit, Fit], there: Simulator, at_a: Linear, at_b: Linear) -> float:
    """The separation, from both models in a further recording."""
    if not all(np.isfinite(series).all() for at in (at_a, at_b) for series in (at.y, at.J)):
        return float("nan")
    metric = Metric.of(there, at_a)
    d = metric(at_b.y - at_a.y).reshape(-1)
    J: Float[np.ndarray, "p samples"] = metric(np.concatenate([at_a.J, -at_b.J])).reshape(-1, d.size)
    known = block_diag(*(fit.precision for fit in fits))
    score = J @ d
    return float(np.sqrt(max(d @ d - score @ np.linalg.solve(known + J @ J.T, score), 0.0)))


def _later(fit: Fit) -> Float[np.ndarray, " d"]:
    """theta in a further recording, in which what came and went in the first (a gust) does not come again."""
    space = fit.simulator.space
    return np.array([null(p) if _passed(p) else x for p, x in zip(space.parameters, fit.theta, strict=True)])


def _passed(p: Parameter) -> bool:
    """Whether a parameter belongs to an effect that begins at a moment."""
    return f"{p.name.split('.')[0]}.start" in EFFECT_PARAMETERS


def advice(a: Model, b: Model, held_out: Observation | None = None) -> str:
    """Which further recording would separate them, or that none of the menu would, in a sentence.

    A new drive is asked for only where one that was held out is not worth fitting, another sensor only where no drive
    is worth it.
    """
    ours, theirs = ([name for name in one.effects if name not in other.effects] for one, other in ((a, b), (b, a)))
    pair = f"{' with '.join(ours or a.effects)} from {' with '.join(theirs or b.effects)}"
    if held_out and (apart := separation_in(a.fit, b.fit, held_out)) >= WORTH:
        return (
            f"To tell {pair}, fit what was held out too, and hold out another drive: they would differ by {apart:.0f} "
            "standard deviations."
        )
    ranked = separations(a, b)
    if not ranked or ranked[0].separation < HIDDEN:
        most = f": they would differ by {ranked[0].separation:.1f} standard deviations at most" if ranked else ""
        return f"None of the drives and sensors that were tried would tell {pair}{most}."
    best = next((one for one in ranked if one.drive in MENU and one.separation >= WORTH), ranked[0])
    apart = (
        f"{best.separation:.0f} standard deviations{'' if best.separation >= WORTH else f' ({WORTH:.0f} would tell)'}"
    )
    return f"To tell {pair}, record {best.drive}: they would differ by {apart}."
