"""Real recordings (level L2) with something injected into their channels, and untouched ones as controls.

What is injected stands in the channels of the whole drive, held-out part included: a car property, not an incident.
Whether the recording is perfectly modelled without it is not known and not claimed; the ratio that is sealed is that of
the change alone, against noise estimated from what the best fit of the base model leaves over of the untouched one.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from concealed.actuators_and_sensors import changed, later
from concealed.case_files import write_case, write_sealed
from concealed.cases import DETECTABLE
from concealed.concealment import CLOSE, SHORT, settle
from concealed.mix import SNRS, Slot
from concealed.strength import Given, Projection, fit, residual, snr
from vehicle_sbi.data.channels import CHANNELS, NEEDED
from vehicle_sbi.data.noise import EstimatedNoise, from_residual
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.vehicle import read as read_vehicle

ROOT = Path(__file__).resolve().parents[2]
Series = dict[str, np.ndarray]


@dataclass(frozen=True, kw_only=True)
class Source:
    """A real recording: its vehicle's name, lengths [s] of the training and the held-out part, what is predicted, how
    far l_f may be off [m]; another file in place of its configuration's, below the folder of recordings."""

    configuration: str
    vehicle: str
    train_s: float
    heldout_s: float
    channels: tuple[str, ...]
    v_min: float = 3.0  # [m/s]
    l_f_off: float = 0.3
    file: str | None = None

    def content(self) -> dict:
        """Its configuration, with the path of the file."""
        content = yaml.safe_load((ROOT / "conf" / "recording" / f"{self.configuration}.yaml").read_text())["recording"]
        folder = os.environ.get("VEHICLE_SBI_RECORDINGS", "../shared/recordings")
        named = content["path"].replace("${oc.env:VEHICLE_SBI_RECORDINGS,../shared/recordings}", folder)
        content["path"] = str(ROOT / (f"{folder}/{self.file}" if self.file else named))
        return {key: value for key, value in content.items() if key != "_target_"}


SOURCES: Mapping[str, Source] = {
    one.configuration: one
    for one in (
        Source(configuration="volvo_s90_slalom", vehicle="volvo_s90", train_s=20.0, heldout_s=10.0,
               channels=("a_y", "yaw_rate")),
        Source(configuration="ferrari_250lm", vehicle="ferrari_250lm", train_s=30.0, heldout_s=20.0,
               channels=("a_y", "yaw_rate")),
        Source(configuration="toyota_rav4_car", vehicle="toyota_rav4", train_s=30.0, heldout_s=15.0,
               channels=("a_x", "yaw_rate")),
    )
}  # fmt: skip
INJECTED = {
    "steering_ratio": ("gain",),
    "sensor_delay": ("imu",),
    "sensor_lag": ("imu",),
    "accelerometer_bias": ("x", "y"),
    "accelerometer_scale": ("x", "y"),
    "gyro_bias": ("z",),
    "gyro_scale": ("z",),
    "steering_delay": ("time",),
}
"""Effects of the catalogue that can be put into recorded channels, and which of their parameters."""


def available(sources: Mapping[str, Source] = SOURCES) -> list[str]:
    """The sources whose files are here."""
    return [name for name, one in sources.items() if Path(one.content()["path"]).exists()]


def _cut(recording: Recording, start: float, stop: float, ratio: float | None) -> Recording:
    """A stretch with only what drives and is measured, on a clock that starts at 0, steering at the road wheels."""
    kept = (recording.t >= start) & (recording.t < stop)
    channels = {}
    for name in ("steering", "v_x", "a_x", "a_y", "yaw_rate"):
        series = recording.series(name)
        if series is None and name == "steering" and ratio:
            series = recording.series("steering_wheel")
            series = None if series is None else (series[0] / ratio, series[1])
        if series is not None:
            channels[name] = np.where(series[1], series[0], np.nan)[kept]
    t = np.arange(int(kept.sum())) / recording.rate
    valid = {name: np.isfinite(values) for name, values in channels.items()}
    return replace(recording, t=t, channels=channels, valid=valid, groups={}, name="a")


def inject(recording: Recording, effect: str, parameters: Mapping[str, float]) -> Recording:
    """The recording as a car with the effect would have left it: a true gain of 1.1 is a stated angle over 1.1."""
    channels = dict(recording.channels)
    if effect == "steering_ratio":
        channels["steering"] = channels["steering"] / parameters["gain"]
    elif effect == "steering_delay":  # the wheels lag behind the record: the record is early
        channels["steering"] = later(channels["steering"][::-1], recording.t, parameters["time"])[::-1]
    else:
        measured = {n: v for n, v in channels.items() if n not in ("steering", *NEEDED["speed"])}
        channels |= changed(measured, recording.t, {effect: parameters})
    return replace(recording, channels=channels)


def _given(rng: np.random.Generator, source: Source, effect: str | None) -> Given:
    """What every installed sensor may have is fitted, unless it is what was injected."""
    vehicle = read_vehicle(str(ROOT / "conf" / "vehicle" / f"{source.vehicle}.yaml"))
    known: Any = vehicle
    prior = {
        "C_alpha_f": (0.5 * known.C_alpha_f, 2.5 * known.C_alpha_f),
        "C_alpha_r": (0.5 * known.C_alpha_r, 2.5 * known.C_alpha_r),
        "l_f": (known.l_f - source.l_f_off, known.l_f + source.l_f_off),
        "steering_offset.angle": (-0.02, 0.02),
    }
    if effect not in ("steering_ratio", "gyro_scale", "accelerometer_scale") and rng.uniform() < 0.6:
        prior["steering_ratio.gain"] = (0.8, 1.25)
    if effect != "accelerometer_bias":
        prior[f"accelerometer_bias.{source.channels[0][-1]}"] = (-0.5, 0.5)
    if effect != "gyro_bias":
        prior["gyro_bias.z"] = (-0.02, 0.02)
    return Given(
        vehicle=vehicle, model="single_track", drive="speed", channels=source.channels, prior=prior, v_min=source.v_min
    )


@dataclass(frozen=True, kw_only=True)
class Stretch:
    """A stretch to train on and one to hold out, what is injected at full strength, and how strongly it shows."""

    source: str
    given: Given
    train: Recording
    heldout: Recording
    extreme: Mapping[str, float]
    change: Callable[[float], np.ndarray | None]
    projection: Projection
    theta: np.ndarray

    def measure(self, strength: float) -> float | None:
        """The signal-to-noise ratio of what is injected beyond what the base model's parameters can take over."""
        change = self.change(strength)
        return None if change is None else snr(self.projection.left(change[None]))

    def parameters(self, effect: str, strength: float) -> dict[str, float]:
        return _parameters(self.extreme, effect, strength)


def _parameters(extreme: Mapping[str, float], effect: str, strength: float) -> dict[str, float]:
    null = {key: EFFECT_PARAMETERS[f"{effect}.{key}"].null or 0.0 for key in extreme}
    return {key: null[key] + strength * (value - null[key]) for key, value in extreme.items()}


def stretch(rng: np.random.Generator, effect: str | None, source: str, facts: Source) -> Stretch:
    """Anywhere in a recording; InputError where nothing of it can be used."""
    given = _given(rng, facts, effect)
    recording = RecordingFile(**facts.content()).load()
    length = float(recording.t[-1] - recording.t[0])
    begin = recording.t[0] + rng.uniform(0.0, max(length - facts.train_s - facts.heldout_s - 1.0, 0.0))
    ratio, middle = given.vehicle.steering_ratio, begin + facts.train_s
    train = _cut(recording, begin, middle, ratio)
    heldout = _cut(recording, middle + 1.0, middle + 1.0 + facts.heldout_s, ratio)
    simulator = given.simulator([train])
    given.simulator([heldout])  # raises where nothing of it can be used
    simulator = simulator.with_noise(EstimatedNoise().measurement(simulator.windows))
    theta, rest = (simulator.space.low + simulator.space.high) / 2, simulator.windows.y
    for _ in range(3):
        theta = fit(simulator, simulator.windows.y, theta)
        rest = residual(simulator, theta, simulator.windows.y)
        simulator = simulator.with_noise(from_residual(rest, simulator.windows))
    projection = Projection(simulator, theta)
    extreme: dict[str, float] = {}
    if effect:
        axes = [k for k in INJECTED[effect] if effect[:5] != "accel" or f"a_{k}" in facts.channels]
        for key in axes:
            p = EFFECT_PARAMETERS[f"{effect}.{key}"]
            extreme[key] = p.high if rng.uniform() < 0.5 or p.low == p.null else p.low

    quiet, t = simulator.noise_free(theta[None])[0], np.arange(simulator.windows.t.shape[1]) / simulator.windows.rate

    def read(parameters: Mapping[str, float]) -> np.ndarray:
        """The simulated series as the changed sensors report it: recorded noise must not count as a change."""
        windows = quiet.reshape(len(facts.channels), -1, len(t)).transpose(1, 0, 2)
        reported = [changed(dict(zip(facts.channels, w, strict=True)), t, {effect or "": parameters}) for w in windows]
        return np.concatenate([np.stack([w[c] for c in facts.channels]) for w in reported], axis=1)

    def changed_by(strength: float) -> np.ndarray | None:
        parameters = _parameters(extreme, effect or "", strength)
        change = read(parameters) - quiet
        if effect in ("steering_ratio", "steering_delay"):
            moved = given.simulator([inject(train, effect, parameters)])
            if moved.windows.y.shape != quiet.shape:
                return None
            change = quiet - moved.noise_free(theta[None])[0]
        return change if np.isfinite(change).all() else None

    return Stretch(
        source=source, given=given, train=train, heldout=heldout, extreme=extreme, change=changed_by,
        projection=projection, theta=theta,
    )  # fmt: skip


def build(seed: int, wanted: Slot, case: Path, sealed: Path) -> None:
    """A case of level L2. Raises InputError where no recording is here or none can be used."""
    effect, chosen, strength, reached = (wanted.effects or (None,))[0], None, 0.0, 0.0
    for k in range(8):
        rng = np.random.default_rng((seed, 20, wanted.index, k))
        here = available()
        if not here:
            raise InputError("level L2 needs the real recordings; VEHICLE_SBI_RECORDINGS names their folder")
        try:
            name = here[int(rng.integers(len(here)))]
            one = stretch(rng, effect, name, SOURCES[name])
        except (InputError, np.linalg.LinAlgError):
            continue  # the stretch has no usable window, or a car spins out in it
        chosen = chosen or one
        if effect is None:
            break
        at, most = settle(one.measure, wanted.snr)
        if most > reached:
            chosen, reached, strength = one, most, at
        if most >= (1.0 - CLOSE) * wanted.snr:
            break
    if chosen is None:
        raise InputError(f"case {wanted.index}: no stretch of a real recording can be used")
    below = [v for v in SNRS if v <= reached]
    if below and reached < (1.0 - CLOSE) * wanted.snr:
        strength, reached = settle(chosen.measure, max(below))
    parameters = _parameters(chosen.extreme, effect, strength) if effect else {}
    files = {}
    for name, recording in (("a.csv", chosen.train), ("heldout_0.csv", chosen.heldout)):
        acting = inject(recording, effect, parameters) if effect else recording
        files[name] = {"time": acting.t} | {n: v for n, v in acting.channels.items() if n in CHANNELS}
    untouched = {f"{n}:{c}": v for n, r in (("a.csv", chosen.train),) for c, v in r.channels.items()}
    truth = {
        "index": wanted.index,
        "level": "L2",
        "kind": wanted.kind,
        "world": chosen.source,
        "regime": "as driven",
        "effects": {
            effect: {
                "parameters": parameters, "active": sorted(parameters), "inside": True, "snr": reached,
                "snr_beyond": reached, "spans": {}, "once": False,
            }
        } if effect else {},
        "snr_drawn": wanted.snr,
        "snr": reached,
        "detectable": bool(effect is None or reached >= (1 - SHORT) * DETECTABLE),
        "snr_of_nothing": None,
        "noise": None,
        "base_parameters": {},
        "base_fit": dict(zip(chosen.given.prior, map(float, chosen.theta), strict=True)),
        "heldout": ["heldout_0.csv"],
        "heldout_comparable": False,
    }  # fmt: skip
    write_sealed(sealed, wanted.index, truth, untouched)
    write_case(case, chosen.given, files, ["heldout_0.csv"])
