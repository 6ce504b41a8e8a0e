"""What the catalogue does not have: a load, a steering error or a sensor's error that follows a signal of the drive.

A law is a target (a force along x or y, a moment about z, the road wheels' angle, one channel's sensor) in proportion
to a signal: steering, speed, accelerations and yaw rate of the fitted model, time, and their powers and products. None
of them is physics with a name. Together they are what *unknown* means beside the catalogue: a set of effects that
leaves over what one of them explains is no explanation.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.hypotheses.hypothesis import Hypothesis, changes_of
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.sensors import MEASUREMENTS
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.physics.vehicle import GRAVITY
from vehicle_sbi.threads import each

MOTION = ("v_x", "a_x", "a_y", "yaw_rate")  # of the fitted model, that signals are made of
LOAD = 0.1  # of the car's weight, at most, as a force at its root mean square; over its wheelbase, as a moment
ERROR = 0.3  # of a signal's root mean square, at most, as an error of steering or sensor at its own
STEADY = 1e-3  # of its root mean square, below which a signal's spread is none
STEP = 0.05  # of a law's largest size, for differences
ALIKE = 0.98  # coherence with an effect from which a law says nothing new
Course = Float[np.ndarray, "windows time"]


@dataclass(frozen=True)
class Target:
    """What a law acts on: its size, and the sensor's row of MEASUREMENTS if it is one."""

    name: str
    size: Parameter
    row: int | None = None


@dataclass(frozen=True)
class Law:
    """A target that follows a signal; its size is that where `course` is 1, the signal's root mean square."""

    target: Target
    signal: str
    course: Course

    @property
    def name(self) -> str:
        return f"{self.target.name} with {self.signal}"


def signals(simulator: Simulator, theta: Float[np.ndarray, " d"]) -> dict[str, Course]:
    """Signals of the drive that change, by name, in units of their root mean squares; speed and time about their
    means."""
    windows = simulator.windows
    watched = replace(simulator, windows=replace(windows, channels=MOTION, groups=("imu",) * len(MOTION)))
    speed, a_x, a_y, yaw_rate = watched.noise_free(theta[None])[0].reshape(len(MOTION), *windows.t.shape)
    steering, time = (windows.u[..., INPUTS.index(name)] for name in ("steering", "time"))
    turning = np.gradient(steering, axis=1) * windows.rate
    odd = {"steering": steering, "yaw rate": yaw_rate, "a_y": a_y, "a_x": a_x, "steering rate": turning}
    slow = {"speed": speed, "time": time}
    x = {name: _scaled(value) for name, value in odd.items()}
    x |= {name: _scaled(value - float(value.mean())) for name, value in slow.items()}
    found = {f"|{name}|": np.abs(x[name]) for name in odd}
    found |= {f"{name} cubed": x[name] ** 3 for name in ("steering", "yaw rate", "a_y", "a_x")}
    found |= {f"{name} squared": x[name] ** 2 for name in slow}
    found |= {f"{a} times {b}": x[a] * x[b] for a in ("steering", "yaw rate", "a_y") for b in ("speed", "a_x", "time")}
    found["dynamic pressure"] = speed**2
    found["direction of steering"] = np.tanh(3.0 * x["steering rate"])
    x |= {name: _scaled(value) for name, value in found.items()}
    return {name: course for name, course in x.items() if np.std(course) > STEADY}


def _scaled(signal: Course) -> Course:
    """With a root mean square of 1, if it has any."""
    size = float(np.sqrt(np.mean(signal**2)))
    return signal / size if size > 1e-9 else np.zeros_like(signal)


def targets(simulator: Simulator, y: Float[np.ndarray, "channels time"]) -> list[Target]:
    """Everything that may be off where the series are y: forces and a moment, the steering, each channel's sensor."""
    weight, L = GRAVITY * float(simulator.nominal["m"]), float(simulator.nominal["L"])
    steering = np.sqrt(np.mean(simulator.windows.u[..., INPUTS.index("steering")] ** 2))
    found = [
        Target("force along x", size_of_latent("x", "N", LOAD * weight)),
        Target("force along y", size_of_latent("y", "N", LOAD * weight)),
        Target("moment about z", size_of_latent("z", "N m", LOAD * weight * L)),
    ]
    if steering > 0.0:
        found.append(Target("error of the steering angle", size_of_latent("steering", "rad", ERROR * float(steering))))
    for c, channel in enumerate(simulator.windows.channels):
        largest = ERROR * float(np.sqrt(np.nanmean(y[c] ** 2))) + 3.0 * float(simulator.noise.floor[c])
        size = size_of_latent("sensor", CHANNELS[channel].unit, largest)
        found.append(Target(f"error of the sensor of {channel}", size, MEASUREMENTS.index(channel)))
    return found


def laws(simulator: Simulator, theta: Float[np.ndarray, " d"], y: Float[np.ndarray, "channels time"]) -> list[Law]:
    """Every target with every signal that changes at theta, where the series are y."""
    acting, courses = targets(simulator, y), signals(simulator, theta)
    return [Law(target, signal, course) for signal, course in courses.items() for target in acting]


def tested(about: Linearised, effects: Sequence[Hypothesis]) -> list[Hypothesis]:
    """Laws, but for those that do what one of some effects does."""
    fit = about.fit
    given = laws(fit.simulator, fit.theta, fit.at.y)
    changes = law_slopes(fit.simulator, fit.theta, fit.at.y, given)
    new = about.coherence(changes, changes_of(effects, fit.at.y.shape)).max(axis=1, initial=0.0) < ALIKE
    found = [
        Hypothesis(law.name, law.target.size.low, law.target.size.high, change)
        for law, change in zip(given, changes, strict=True)
    ]
    return [*itertools.compress(found, new)]


def size_of_latent(name: str, unit: str, largest: float) -> Parameter:
    return Parameter(name=f"latent.{name}", unit=unit, low=-largest, high=largest, fields=(f"latent_{name}",), null=0.0)


def under(simulator: Simulator, given: Sequence[Law]) -> Simulator:
    """The simulator with the sizes of laws as further parameters. All of them follow one signal; either none is a
    sensor's error, or all are errors of one sensor."""
    u, nominal, row = simulator.windows.u.copy(), simulator.nominal.copy(), given[0].target.row
    u[..., INPUTS.index("latent")] = given[0].course
    nominal["latent_row"] = -1.0 if row is None else float(row)
    space = ParameterSpace((*simulator.space.parameters, *(law.target.size for law in given)))
    return replace(simulator, space=space, windows=replace(simulator.windows, u=u), nominal=nominal)


def law_slopes(
    simulator: Simulator, theta: Float[np.ndarray, " d"], y: Float[np.ndarray, "channels time"], given: Sequence[Law]
) -> Float[np.ndarray, "k channels time"]:
    """Change of the series y at theta per unit of each law's size: simulated in the windows in which it acts."""
    changes, windows = np.zeros((len(given), *y.shape)), simulator.windows.t.shape
    together: dict[str, list[int]] = {}
    for k, law in enumerate(given):
        if law.target.row is None:
            together.setdefault(law.signal, []).append(k)
        else:
            changes[k, simulator.windows.channels.index(MEASUREMENTS[law.target.row])] = law.course.reshape(-1)

    def simulate(rows: list[int]) -> None:
        acts = given[rows[0]].course.any(axis=1)
        steps = STEP * np.array([given[k].target.size.high for k in rows])
        there = under(simulator, [given[k] for k in rows]).only(np.flatnonzero(acts))
        moved = there.noise_free(np.column_stack([np.tile(theta, (len(rows), 1)), np.diag(steps)]))
        samples = np.flatnonzero(np.repeat(acts, windows[1]))
        changes[np.ix_(np.array(rows), np.arange(len(y)), samples)] = (moved - y[:, samples]) / steps[:, None, None]

    each(simulate, together.values())
    return changes
