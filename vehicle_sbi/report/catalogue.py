"""The catalogue of effects as a page: what each means, its equation, parameters, and what it does to each channel."""

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
from jaxtyping import Float
from matplotlib.figure import Figure

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.manoeuvre import Manoeuvre
from vehicle_sbi.data.noise import ConstantNoise, ProcessNoise
from vehicle_sbi.files import write_atomically, write_text
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, Effect
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.physics.vehicle import Vehicle
from vehicle_sbi.report.figures import MEASURED, POSTERIOR, STYLE
from vehicle_sbi.rng import Stream, generator

SHOWN: tuple[str, ...] = ("a_x", "a_y", "yaw_rate", "wheel_speed_front", "wheel_speed_rear")
SIMULATED: tuple[str, ...] = (*SHOWN, "v_x")  # shown where an effect acts on nothing else
STAGES = {"command": "Command to wheels", "force": "Forces on the body", "tyre": "Tyres", "sensor": "Sensors"}
DPI = 80
AWAKE = 0.5  # of the way from null to the farther bound
SUBSTEPS = 2


def awake(effect: Effect) -> dict[Parameter, float]:
    """Every parameter of an effect well away from its null: halfway to the bound that is farther off."""
    values = {}
    for p in effect.parameters:
        assert p.null is not None
        far = p.high if p.high - p.null >= p.null - p.low else p.low
        values[p] = p.null + AWAKE * (far - p.null)
    return values


def exemplar(vehicle: Vehicle, manoeuvre: Manoeuvre, model: str) -> Simulator:
    """A simulator of the vehicle in the manoeuvre, without any noise and with nothing free."""
    windows = replace(manoeuvre, channels=SIMULATED).windows(vehicle)
    quiet = ProcessNoise(stiffness=0.0)
    return Simulator(
        nominal=nominal_record(vehicle, duration=manoeuvre.duration),
        space=ParameterSpace(()),
        model=model,
        drive="torque",
        windows=windows,
        process=quiet.draw(generator(seed=0, stream=Stream.STUDY)),
        noise=ConstantNoise(std=dict.fromkeys(SIMULATED, 1.0), process=quiet).measurement(windows),
        uniform_start=True,
        substeps=SUBSTEPS,
        seed=0,
    )


def response(simulator: Simulator, values: dict[Parameter, float]) -> Float[np.ndarray, "channels time"]:
    """What the sensors measure with effect parameters at the given values."""
    free = replace(simulator, space=ParameterSpace(tuple(values)))
    return free.noise_free(np.array([list(values.values())]))[0]


def picture(simulator: Simulator, effect: Effect, path: Path) -> None:
    """Each channel without the effect (grey) and with it awake (blue)."""
    t = simulator.windows.t[0]
    without, present = (dict(zip(SIMULATED, response(simulator, at), strict=True)) for at in ({}, awake(effect)))
    acts = [name for name in SIMULATED if not np.array_equal(without[name], present[name])]
    names = SHOWN if set(acts) & set(SHOWN) else acts or SHOWN
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(2.4 * len(names), 2.0), layout="constrained")
        for axis, name in zip(figure.subplots(1, len(names), squeeze=False)[0], names, strict=True):
            axis.plot(t, without[name], color=MEASURED, linewidth=1.0, alpha=0.6)
            axis.plot(t, present[name], color=POSTERIOR, linewidth=1.2)
            axis.set_title(f"{name.replace('_', ' ')} [{CHANNELS[name].unit}]")
            axis.set_xlabel("t [s]")
        write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None}))


def section(effect: Effect) -> str:
    """One effect in Markdown."""
    rows = [f"| `{p.name}` | {p.unit} | {p.low:g} to {p.high:g} | {p.null:g} |" for p in effect.parameters]
    values = ", ".join(f"{p.name.partition('.')[2]} {value:g}" for p, value in awake(effect).items())
    return "\n".join(
        [
            f"### {effect.name}",
            "",
            f"{effect.meaning[0].upper()}{effect.meaning[1:]} (source: {effect.source}).",
            "",
            f"    {effect.equation}",
            "",
            "| parameter | unit | prior | null |",
            "| --- | --- | --- | --- |",
            *rows,
            "",
            f"![{effect.name}](effects/{effect.name}.png)",
            "",
            f"Shown: {values}.",
        ]
    )


def page(car: str, drive: str) -> str:
    """The whole page in Markdown; `car` and `drive` say in words what the pictures show."""
    parts = [
        "# The catalogue of effects",
        "",
        "What a simple model leaves out. Every effect is always compiled in; at its null it vanishes exactly. Free",
        "some with `effects=[aero_drag,road_grade]`, one parameter alone with `effects=[sensor_lag.a_y]`, or state",
        "their priors: `prior.aero_drag.area=[0,1]`. What one channel has beside its group of sensors is only free",
        "where it is named. Times count from the first sample that is used, of all recordings one after another.",
        "",
        f"The pictures: {car} in {drive}; grey without the effect, blue with it.",
        "This page is written by `python scripts/catalogue.py` from `vehicle_sbi/physics/effects.py`.",
    ]
    for stage, title in STAGES.items():
        parts += ["", f"## {title}"]
        parts += [f"\n{section(effect)}" for effect in CATALOGUE.values() if effect.enters_at == stage]
    return "\n".join(parts) + "\n"


def write(folder: Path, vehicle: Vehicle, manoeuvre: Manoeuvre, model: str) -> None:
    """effects.md and a picture for each effect under `folder`."""
    simulator = exemplar(vehicle, manoeuvre, model)
    (folder / "effects").mkdir(parents=True, exist_ok=True)
    for effect in CATALOGUE.values():
        picture(simulator, effect, folder / "effects" / f"{effect.name}.png")
    write_text(folder / "effects.md", page(f"the {vehicle.name} car, {model}", manoeuvre.name))
