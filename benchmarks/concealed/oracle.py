"""What an extended model could remove at best: held-out recordings as predicted by one who knows what was concealed.

That is the project's own model with the true effects at their true sizes and the base parameters that fit the car
without them, driven by the same measured inputs, noise and all: no model can do away with that of the inputs.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from concealed.baselines import given
from concealed.strength import Noise
from vehicle_sbi.data.readers import read
from vehicle_sbi.data.windows import joined
from vehicle_sbi.files import write_text
from vehicle_sbi.mismatch.estimation.fit import Fit, linearise
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.problem.case import halves
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.predictive import predict
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS


def held_out(case: Path, truth: Mapping[str, Any]) -> Observation:
    """The samples by which the tool proves what it says, under the base model."""
    told, content = given(case)
    recordings = [read(case / name) for name in content["heldout"]]
    simulator = told.simulator(recordings, Noise(**truth["noise"]))
    windows = joined([told.windows(one) for one in recordings], content["heldout"])
    windows = replace(windows, x0_std=simulator.windows.x0_std)
    observed = np.where(windows.valid, windows.y, 0.0)
    return halves(Observation(replace(simulator, windows=windows), observed, False))[1]


def errors(case: Path, truth: Mapping[str, Any]) -> dict[str, float]:
    """Error of each held-out channel over its spread, as the tool counts its own."""
    observation = held_out(case, truth)
    base = truth["base_parameters"] if truth["level"] == "L0" else truth["base_fit"]
    effects = {f"{name}.{key}": v for name, one in truth["effects"].items() for key, v in one["parameters"].items()}
    space = observation.simulator.space
    added = {EFFECT_PARAMETERS[name]: value for name, value in effects.items() if name not in space.names}
    theta = np.array([*(effects.get(name, base.get(name)) for name in space.names), *added.values()], dtype=float)
    simulator = replace(observation.simulator, space=ParameterSpace((*space.parameters, *added)))
    knowing = Fit(observation.extended(simulator), theta, linearise(simulator, theta))
    predicted = predict(Model((), knowing, ()), observation, apart=False)
    if predicted is None:
        raise RuntimeError("the truth cannot be simulated in the held-out recordings")
    return predicted.nrmse


def write(case: Path, truth: Path) -> None:
    """TRUTH's oracle beside it, unless it stands already; none where an effect is unknown to the model, or timed."""
    sealed, path = json.loads(truth.read_text()), truth.with_suffix(".oracle.json")
    known = sealed["effects"] and all(one["inside"] for one in sealed["effects"].values())
    if known and sealed["heldout_comparable"] and not path.exists():
        write_text(path, json.dumps(errors(case, sealed)))
