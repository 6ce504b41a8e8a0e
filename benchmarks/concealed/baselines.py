"""What simpler methods say of the same files: forward selection by BIC, the largest correlation, the lasso, MMD.

The first three see the residual of the best fit of the base model and the catalogue's directions, both whitened by
noise that is estimated from that residual, and projected on what the fit leaves. The last is sbi's test whether the
recording is like anything that the base model simulates from its prior, in the paper's statistics (Schmitt et al. 2023,
Detecting model misspecification in amortized Bayesian inference); it names nothing.
"""

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
import yaml
from sbi.diagnostics.misspecification import calc_misspecification_mmd
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LassoLarsIC

from concealed.responses import candidates, slopes
from concealed.strength import Given, Projection, fit, residual
from vehicle_sbi.data.noise import EstimatedNoise, from_residual
from vehicle_sbi.data.readers import read as read_recording
from vehicle_sbi.files import write_text
from vehicle_sbi.inference.features import Handcrafted
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.physics.simulation import FINISHED
from vehicle_sbi.physics.vehicle import read as read_vehicle
from vehicle_sbi.rng import Stream

ROUNDS = 3  # of fit and noise
MOST = 6  # effects that forward selection adds
SIMULATED, LEVEL = 300, 0.05  # of MMD
A_MISMATCH = "a mismatch"  # what is said where nothing is named


def given(case: Path) -> tuple[Given, Mapping[str, Any]]:
    """What a case's files tell, as the tool is told it."""
    content = yaml.safe_load((case / "case.yaml").read_text())
    return Given(
        vehicle=read_vehicle(str(case / "vehicle.yaml")),
        model=content["model"],
        drive=content["drive"],
        channels=tuple(content["channels"]),
        prior={name: tuple(box) for name, box in content["prior"].items()},
        v_min=content["v_min"],
    ), content


def answers(case: Path, *, tested: bool = True) -> dict[str, list[str]]:
    """What each method says of a case's files."""
    told, content = given(case)
    return said(told.simulator([read_recording(case / name) for name in content["recordings"]]), tested=tested)


def said(simulator: Simulator, *, tested: bool = True) -> dict[str, list[str]]:
    """The effects that each method names, the first one first; nothing named is nothing detected. The test that names
    nothing is left out where it is not `tested`."""
    windows, space = simulator.windows, simulator.space
    simulator = simulator.with_noise(EstimatedNoise().measurement(windows))
    theta = (space.low + space.high) / 2
    for _ in range(ROUNDS):
        theta = fit(simulator, windows.y, theta)
        simulator = simulator.with_noise(from_residual(residual(simulator, theta, windows.y), windows))
    projection = Projection(simulator, theta)
    found = candidates(simulator, theta)
    r = projection.left(residual(simulator, theta, windows.y)[None])[0]
    g = projection.left(slopes(simulator, theta, found))
    size = np.linalg.norm(g, axis=1)
    seen = size > 1e-6 * size.max()
    g, names = g[seen] / size[seen, None], [d.effect for d, ok in zip(found, seen, strict=True) if ok]
    named = {"bic": _forward(r, g, names), "correlation": _correlation(r, g, names), "lasso": _lasso(r, g, names)}
    return named | ({"mmd": [A_MISMATCH] if _mmd(simulator) < LEVEL else []} if tested else {})


def _mmd(simulator: Simulator) -> float:
    """p-value of the recording among simulations from the prior."""
    windows, space, handcrafted = simulator.windows, simulator.space, Handcrafted()
    theta = np.random.default_rng(0).uniform(space.low, space.high, (SIMULATED, len(space)))
    y, outcomes = simulator.simulate(theta, np.arange(SIMULATED), stream=Stream.SIMULATION)
    x = handcrafted.statistics(y[outcomes == FINISHED], windows.rate)
    observed = handcrafted.statistics(np.where(windows.valid, windows.y, 0.0)[None], windows.rate)
    mean, std = x.mean(axis=0), x.std(axis=0) + 1e-12
    seen, simulated = (torch.as_tensor((one - mean) / std, dtype=torch.float32) for one in (observed, x))
    torch.manual_seed(0)
    return float(calc_misspecification_mmd(seen, simulated, mode="x_space")[0])


def _correlation(r: np.ndarray, g: np.ndarray, names: list[str]) -> list[str]:
    return list(dict.fromkeys(names[i] for i in np.argsort(-abs(g @ r))))[:2]


def _forward(r: np.ndarray, g: np.ndarray, names: list[str]) -> list[str]:
    """Directions added while they lower the sum of squares by more than ln n each, n the samples."""
    left, basis, named = r.copy(), g.copy(), []
    for _ in range(MOST):
        size = np.linalg.norm(basis, axis=1)
        gain = np.where(size > 0.05, (basis @ left / np.maximum(size, 0.05)) ** 2, 0.0)
        best = int(np.argmax(gain))
        if gain[best] <= np.log(np.count_nonzero(r)):
            break
        unit = basis[best] / size[best]
        left, basis = left - (unit @ left) * unit, basis - np.outer(basis @ unit, unit)
        named.append(names[best])
    return list(dict.fromkeys(named))


def _lasso(r: np.ndarray, g: np.ndarray, names: list[str]) -> list[str]:
    kept = r != 0.0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)  # of directions that are nearly the same
        model = LassoLarsIC(criterion="bic", fit_intercept=False, noise_variance=1.0).fit(g[:, kept].T, r[kept])
    order = np.argsort(-abs(model.coef_))
    return list(dict.fromkeys(names[i] for i in order if model.coef_[i] != 0.0))


def write(case: Path, *, tested: bool = True) -> None:
    """CASE/baselines.json, unless it stands already."""
    if not (case / "baselines.json").exists():
        write_text(case / "baselines.json", json.dumps(answers(case, tested=tested)))
