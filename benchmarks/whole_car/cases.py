"""Cases of whole cars: the files that the tool gets, and the sealed truth with how strongly each effect shows.

Of each effect it is sealed how much of what it changes, beside all others, no base parameter can take over, and how
much no other effect of the car either; and which effects of the catalogue would have changed the same.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
from concealed import outside
from concealed.case_files import write_case, write_sealed
from concealed.drives import Plan
from concealed.responses import candidates, slopes
from concealed.setups import recording
from concealed.strength import Projection, fit, remove, residual, snr
from concealed.worlds import Series

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.physics.effects import CATALOGUE
from whole_car.cars import INHERENT, WORLDS, WholeCar, whole_car

ALIKE = 0.95  # coherence, from which an effect cannot be told from another
ATTEMPTS, GENTLER = 20, 6  # cars that are drawn, and drives that are slowed down, until all can be driven
STREAM = 30
Effects = Mapping[str, Mapping[str, float]]


def build(seed: int, index: int, folder: Path, worlds: Mapping[str, float] = WORLDS) -> None:
    """Case `index` under folder/cases, its truth under folder/sealed; nothing to do where it stands."""
    case, sealed = folder / "cases" / f"{index:04d}", folder / "sealed"
    if (case / "case.yaml").exists() and (sealed / f"{index:04d}.json").exists():
        return
    car, series = driven(seed, index, worlds)
    rng = np.random.default_rng((seed, STREAM + 1, index))
    plans = dict(zip(_names(car), (*car.train, *car.heldout), strict=True))
    held = [name for name in plans if name.startswith("heldout")]
    files = {}
    for (name, plan), one in zip(plans.items(), series, strict=True):
        kept = recording(name, plan, one, car.given, {}).channels
        files[name] = {"time": plan.t} | {channel: car.sensors.reported(channel, x, rng) for channel, x in kept.items()}
    quiet = {f"{name}:{c}": one[c] for name, one in zip(plans, series, strict=True) for c in car.given.channels}
    write_sealed(sealed, index, _truth(index, car, series[: len(car.train)]), quiet)
    write_case(case, car.given, files, held)


def _names(car: WholeCar) -> list[str]:
    fitted = [f"{'ab'[i]}.csv" for i in range(len(car.train))]
    return fitted + [f"heldout_{i}.csv" for i in range(len(car.heldout))]


def driven(seed: int, index: int, worlds: Mapping[str, float] = WORLDS) -> tuple[WholeCar, list[Series]]:
    """The first car drawn that can be driven as planned, or a little gentler, and what its ideal sensors would read."""
    for attempt in range(ATTEMPTS):
        car = whole_car(np.random.default_rng((seed, STREAM, index, attempt)), worlds)
        for _ in range(GENTLER):
            series = ideal_series(car, (*car.train, *car.heldout), car.effects)
            if series is not None and _usable(car, series):
                return car, series
            car = car.gentler(0.85)
    raise RuntimeError(f"case {index}: no car in {ATTEMPTS} can be driven")


def ideal_series(car: WholeCar, plans: Sequence[Plan], effects: Effects) -> list[Series] | None:
    found = [outside.drive(car.world, plan, effects) for plan in plans]
    return [one for one in found if one is not None] if all(one is not None for one in found) else None


def _usable(car: WholeCar, series: Sequence[Series]) -> bool:
    """Whether every recording has a window, and the base model drives through them with the true parameters."""
    try:
        for plan, one in zip((*car.train, *car.heldout), series, strict=True):
            car.given.windows(recording("a", plan, one, car.given, {}))
    except InputError:
        return False
    simulator = base_model(car, series[: len(car.train)])
    truth = np.array([car.base[name] for name in simulator.space.names])
    return bool(np.isfinite(simulator.noise_free(truth[None])).all())


def base_model(car: WholeCar, series: Sequence[Series]) -> Simulator:
    pairs = zip(car.train, series, strict=True)
    return car.given.simulator([recording("a", p, one, car.given, {}) for p, one in pairs], car.sensors.total)


def _truth(index: int, car: WholeCar, series: Sequence[Series]) -> dict[str, Any]:
    simulator = base_model(car, series)
    at = fit(simulator, simulator.windows.y, np.array([car.base[name] for name in simulator.space.names]))
    projection = Projection(simulator, at)
    changes = projection.left(np.array([_change(car, simulator, at, name) for name in car.effects]))
    shows, beyond = [snr(row) for row in changes], [_beyond(changes, i) for i in range(len(changes))]
    alike = alike_to(projection, changes)
    return {
        "index": index,
        "world": car.world_name,
        "inherent": list(INHERENT[car.world_name]),
        "manoeuvres": [p.manoeuvre for p in (*car.train, *car.heldout)],
        "peak": car.peak,
        "effects": {
            name: {
                "parameters": dict(values), "inside": name in CATALOGUE, "snr": shows[i], "snr_beyond": beyond[i],
                "alike": alike[i],
            }
            for i, (name, values) in enumerate(car.effects.items())
        },
        "noise": asdict(car.sensors.noise),
        "steps": dict(car.sensors.steps),
        "base_parameters": dict(car.base),
        "base_fit": dict(zip(simulator.space.names, map(float, at), strict=True)),
        "vehicle": json.loads(json.dumps({k: v for k, v in asdict(car.truth).items() if v not in (None, np.inf)})),
    }  # fmt: skip


def _change(car: WholeCar, simulator: Simulator, at: np.ndarray, name: str) -> np.ndarray:
    """What an effect changes of the base model's residual, all others being there; zero where it is what lets the car
    be driven so."""
    without = ideal_series(car, car.train, {other: values for other, values in car.effects.items() if other != name})
    whole = residual(simulator, at, simulator.windows.y)
    if without is None:
        return np.zeros_like(whole)
    other = base_model(car, without)
    if other.windows.y.shape != simulator.windows.y.shape:
        return np.zeros_like(whole)
    change = whole - residual(other, at, other.windows.y)
    return change if np.isfinite(change).all() else np.zeros_like(whole)


def _beyond(changes: np.ndarray, i: int) -> float:
    """The signal-to-noise ratio of what no other effect's change can stand for."""
    return snr(remove(changes[i : i + 1], np.delete(changes, i, axis=0), entirely=True))


def alike_to(projection: Projection, changes: np.ndarray) -> list[list[str]]:
    """For each change the effects of the catalogue whose parameters, all free, would change (nearly) the same."""
    found = candidates(projection.simulator, projection.theta)
    g = projection.left(slopes(projection.simulator, projection.theta, found))
    names = [d.effect for d in found]
    alike: list[list[str]] = []
    for change in changes:
        size, standing = snr(change), []
        for effect in dict.fromkeys(names):
            rows = g[[name == effect for name in names]]
            if size > 0.0 and snr(remove(change[None], rows, entirely=True)) <= np.sqrt(1.0 - ALIKE**2) * size:
                standing.append(effect)
        alike.append(standing)
    return alike
