"""What could be had at best: the tool's own model and fit, told which effects of the catalogue the car has.

Base parameters and those of the true effects are free, from the truth on, under the tool's own estimate of the noise;
what lies outside the catalogue stays outside. So it is told names, not sizes, and neither tyres nor body that are
others than the model's.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from concealed.baselines import given

from vehicle_sbi.data.noise import EstimatedNoise
from vehicle_sbi.data.readers import read
from vehicle_sbi.data.windows import joined
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.estimation.fit import Fit, descend, with_own_noise
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.problem.case import halves
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.predictive import predict
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS


def knowing(case: Path, truth: Mapping[str, Any]) -> dict[str, Any] | None:
    """NRMSE of the held-out half that proves, and the posterior of every parameter; None where it cannot be fitted."""
    told, content = given(case)
    base = told.simulator([read(case / name) for name in content["recordings"]])
    base = base.with_noise(EstimatedNoise().measurement(base.windows))
    effects = _true(truth)
    added = [EFFECT_PARAMETERS[name] for name in effects]
    simulator = replace(base, space=ParameterSpace((*base.space.parameters, *added)))
    space = simulator.space
    start = np.array([truth["base_parameters"].get(name, effects.get(name)) for name in space.names], dtype=float)
    fit = descend(_observed(simulator), np.clip(start, space.low, space.high))
    if fit is None:
        return None
    fit = with_own_noise(fit)
    predicted = predict(Model((), fit, ()), _held_out(case, fit, content["heldout"]), apart=True)
    if predicted is None:
        return None
    found = Model((), fit, ()).estimates
    return {
        "nrmse": predicted.nrmse,
        "parameters": {n: {"mean": e.mean, "std": e.std, "q05": e.q05, "q95": e.q95} for n, e in found.items()},
    }


def _true(truth: Mapping[str, Any]) -> dict[str, float]:
    """Parameters of the effects that the car has, those of its world's own from their nulls on."""
    own = [p for name in truth["inherent"] for p in CATALOGUE[name].parameters]
    found = {p.name: p.null or 0.0 for p in own}
    for name, one in truth["effects"].items():
        found |= {f"{name}.{key}": value for key, value in one["parameters"].items()} if one["inside"] else {}
    return found


def _observed(simulator: Simulator) -> Observation:
    return Observation(simulator, np.where(simulator.windows.valid, simulator.windows.y, 0.0), True)


def _held_out(case: Path, fit: Fit, names: Sequence[str]) -> Observation:
    """The samples by which the tool proves what it says."""
    told, _ = given(case)
    windows = joined([told.windows(read(case / name)) for name in names], list(names))
    windows = replace(windows, x0_std=fit.simulator.windows.x0_std)
    return halves(_observed(replace(fit.simulator, windows=windows)))[1]


def write(case: Path, truth: Path) -> None:
    """TRUTH's oracle beside it, unless it stands already."""
    path = truth.with_suffix(".oracle.json")
    if not path.exists():
        write_text(path, json.dumps(knowing(case, json.loads(truth.read_text()))))
