"""What the catalogue does not have: a load, a steering error or a sensor's error that follows a signal of the drive.

A law is a target (a force along x or y, a moment about z, the road wheels' angle, one channel's sensor) in proportion
to a signal: steering, speed, accelerations and yaw rate of the fitted model, time, and their powers and products. None
of them is physics with a name. Together they are what *unknown* means beside the catalogue: a set of effects that
leaves over what one of them explains is no explanation.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.sensors import MEASUREMENTS
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.physics.vehicle import GRAVITY

MOTION = ("v_x", "a_x", "a_y", "yaw_rate")  # of the fitted model, that signals are made of
LOAD = 0.1  # of the car's weight, at most, as a force at its root mean square; over its wheelbase, as a moment
ERROR = 0.3  # of a signal's root mean square, at most, as an error of steering or sensor at its own
STEADY = 1e-3  # of its root mean square, below which a signal's spread is none
STEERING = "error of the steering angle"  # a target's name
STEP = 0.05  # of a law's largest size, for differences
Course = Float[np.ndarray, "windows time"]
Unit = tuple[float, float]  # what is taken off a signal, and what the rest is then divided by


@dataclass(frozen=True)
class Target:
    """What a law acts on: its size, and the sensor's row of MEASUREMENTS if it is one."""

    name: str
    size: Parameter
    row: int | None = None


@dataclass(frozen=True)
class Law:
    """A target that follows a signal; its size is that where `course` is 1, the signal's root mean square.

    `units` are those of all signals, for the same law in other recordings.
    """

    target: Target
    signal: str
    course: Course
    units: Mapping[str, Unit] = field(default_factory=dict)

    @property
    def name(self) -> str:
        return f"{self.target.name} with {self.signal}"


def signals(
    simulator: Simulator, theta: Float[np.ndarray, " d"], units: dict[str, Unit] | None = None
) -> dict[str, Course]:
    """Signals of the drive by name, in `units` as far as those are known.

    Other units are added: those in which a signal has a root mean square of 1 here, speed and time about their means.
    """
    units = {} if units is None else units

    def scaled(name: str, signal: np.ndarray, *, centred: bool = False) -> np.ndarray:
        mean, size = units.setdefault(name, _unit(signal, centred))
        return (signal - mean) / size if size > 1e-9 else np.zeros_like(signal)

    windows = simulator.windows
    watched = replace(simulator, windows=replace(windows, channels=MOTION, groups=("imu",) * len(MOTION)))
    speed, a_x, a_y, yaw_rate = watched.noise_free(theta[None])[0].reshape(len(MOTION), *windows.t.shape)
    steering, time = (windows.u[..., INPUTS.index(name)] for name in ("steering", "time"))
    turning = np.gradient(steering, axis=1) * windows.rate
    odd = {"steering": steering, "yaw rate": yaw_rate, "a_y": a_y, "a_x": a_x, "steering rate": turning}
    slow = {"speed": speed, "time": time}
    x = {name: scaled(name, value) for name, value in odd.items()}
    x |= {name: scaled(name, value, centred=True) for name, value in slow.items()}
    found = {f"|{name}|": np.abs(x[name]) for name in odd}
    found |= {f"{name} cubed": x[name] ** 3 for name in ("steering", "yaw rate", "a_y", "a_x")}
    found |= {f"{name} squared": x[name] ** 2 for name in slow}
    found |= {f"{a} times {b}": x[a] * x[b] for a in ("steering", "yaw rate", "a_y") for b in ("speed", "a_x", "time")}
    found["dynamic pressure"] = speed**2
    found["direction of steering"] = np.tanh(3.0 * x["steering rate"])
    return x | {name: scaled(name, value) for name, value in found.items()}


def _unit(signal: np.ndarray, centred: bool) -> Unit:
    """In which a signal has a root mean square of 1, about its mean if it is centred."""
    mean = float(signal.mean()) if centred else 0.0
    return mean, float(np.sqrt(np.mean((signal - mean) ** 2)))


def targets(simulator: Simulator, y: Float[np.ndarray, "channels time"]) -> list[Target]:
    """Everything that may be off where the series are y: forces and a moment, the steering, each channel's sensor."""
    weight, L = GRAVITY * float(simulator.nominal["m"]), float(simulator.nominal["L"])
    steering = np.sqrt(np.mean(simulator.windows.u[..., INPUTS.index("steering")] ** 2))
    found = [
        Target("force along x", _size("x", "N", LOAD * weight)),
        Target("force along y", _size("y", "N", LOAD * weight)),
        Target("moment about z", _size("z", "N m", LOAD * weight * L)),
    ]
    if steering > 0.0:
        found.append(Target(STEERING, _size("steering", "rad", ERROR * float(steering))))
    for c, channel in enumerate(simulator.windows.channels):
        largest = ERROR * float(np.sqrt(np.nanmean(y[c] ** 2))) + 3.0 * float(simulator.noise.floor[c])
        size = _size("sensor", CHANNELS[channel].unit, largest)
        found.append(Target(f"error of the sensor of {channel}", size, MEASUREMENTS.index(channel)))
    return found


def laws(simulator: Simulator, theta: Float[np.ndarray, " d"], y: Float[np.ndarray, "channels time"]) -> list[Law]:
    """Every target with every signal that changes at theta, where the series are y."""
    units: dict[str, Unit] = {}
    acting, courses = targets(simulator, y), signals(simulator, theta, units)
    return [
        Law(target, signal, course, units)
        for signal, course in courses.items()
        if np.std(course) > STEADY
        for target in acting
    ]


def _size(name: str, unit: str, largest: float) -> Parameter:
    return Parameter(name=f"latent.{name}", unit=unit, low=-largest, high=largest, fields=(f"latent_{name}",), null=0.0)


def under(simulator: Simulator, law: Law) -> Simulator:
    """The simulator with the law's size as a further parameter."""
    return followed(replace(simulator, space=ParameterSpace((*simulator.space.parameters, law.target.size))), law)


def followed(simulator: Simulator, law: Law) -> Simulator:
    """The simulator, which has the law's size among its parameters, with the law's course."""
    u, nominal = simulator.windows.u.copy(), simulator.nominal.copy()
    u[..., INPUTS.index("latent")] = law.course
    nominal["latent_row"] = -1.0 if law.target.row is None else float(law.target.row)
    return replace(simulator, windows=replace(simulator.windows, u=u), nominal=nominal)


def law_slopes(
    simulator: Simulator, theta: Float[np.ndarray, " d"], y: Float[np.ndarray, "channels time"], given: Sequence[Law]
) -> Float[np.ndarray, "k channels time"]:
    """Change of the series y at theta per unit of each law's size."""
    changes = np.zeros((len(given), *y.shape))
    together: dict[str, list[int]] = {}
    for k, law in enumerate(given):
        if law.target.row is None:
            together.setdefault(law.signal, []).append(k)
        else:
            changes[k, simulator.windows.channels.index(MEASUREMENTS[law.target.row])] = law.course.reshape(-1)
    for rows in together.values():
        sizes = [given[k].target.size for k in rows]
        simulated = replace(
            under(simulator, given[rows[0]]), space=ParameterSpace((*simulator.space.parameters, *sizes))
        )
        steps = STEP * np.array([p.high for p in sizes])
        moved = simulated.noise_free(np.column_stack([np.tile(theta, (len(rows), 1)), np.diag(steps)]))
        changes[rows] = (moved - y) / steps[:, None, None]
    return changes
