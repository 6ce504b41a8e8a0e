"""Does the fitted model explain what was recorded: posterior predictive, and an honest account of what is left."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
from jaxtyping import Float

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.noise import EstimatedNoise
from vehicle_sbi.inference.information import best_fit
from vehicle_sbi.inference.simulator import Simulator, succeeded
from vehicle_sbi.rng import Stream

DRAWS = 300
QUANTILES = (0.05, 0.5, 0.95)
STRUCTURED = 1.5  # times the sensor noise, above which a residual is called misfit


@dataclass(frozen=True)
class Predictive:
    """Quantiles of simulated measurements under the posterior, noise included, and one row of misfit per channel.

    Quantiles are NaN where the recording is masked. Plausible effects are drawn anew in them, as in all simulations;
    the misfit is what they leave over, each at its best fit. `at` says where the misfit is taken.
    """

    quantiles: Float[np.ndarray, "3 channels time"]
    misfit: pd.DataFrame
    at: str = "at the posterior mean"

    def sentences(self) -> list[str]:
        """What remains unexplained, one sentence a channel."""
        return [_sentence(row, self.at) for row in self.misfit.to_dict("records")]


def predictive(simulator: Simulator, observed: Float[np.ndarray, "channels time"], samples: np.ndarray) -> Predictive:
    """Simulate DRAWS of the posterior samples and compare them with the recording."""
    index = np.arange(min(DRAWS, len(samples)))
    y, outcomes = simulator.simulate(samples[index], index, stream=Stream.PREDICTIVE)
    quantiles = np.quantile(y[succeeded(outcomes)], QUANTILES, axis=0)
    quantiles = np.where(simulator.windows.valid, quantiles, np.nan)
    mean = samples.mean(axis=0, keepdims=True)
    if not len(simulator.plausible):
        return Predictive(quantiles, _misfit(simulator, observed, observed - simulator.noise_free(mean)[0], quantiles))
    left = best_fit(simulator, observed, mean)[1]
    return Predictive(
        quantiles, _misfit(simulator, observed, left, quantiles), "of the best fit, plausible effects in it,"
    )


def _misfit(simulator: Simulator, observed: np.ndarray, left: np.ndarray, quantiles: np.ndarray) -> pd.DataFrame:
    windows = simulator.windows
    recorded = np.isfinite(windows.y).any()
    sensor = EstimatedNoise().measurement(windows).floor if recorded else np.full(len(windows.channels), np.nan)
    rows = []
    for i, name in enumerate(windows.channels):
        valid = windows.valid[i]
        residual = left[i, valid]
        signal = observed[i, valid]
        covered = (observed[i] >= quantiles[0, i]) & (observed[i] <= quantiles[2, i])
        rows.append(
            {
                "channel": name,
                "unit": CHANNELS[name].unit,
                "residual_rms": float(np.sqrt(np.mean(residual**2))),
                "nrmse": float(np.sqrt(np.mean(residual**2)) / max(signal.std(), 1e-12)),
                "coverage90": float(covered[valid].mean()),
                "sensor_noise": float(sensor[i]),
                "lag_one_correlation": float(np.corrcoef(residual[:-1], residual[1:])[0, 1]),
            }
        )
    return pd.DataFrame(rows)


def _sentence(row: dict, at: str) -> str:
    text = (
        f"{row['channel']}: the residual {at} is {row['residual_rms']:.3g} {row['unit']} rms, "
        f"{row['nrmse']:.0%} of the signal's spread; the 90 % band covers {row['coverage90']:.0%} of the samples"
    )
    if np.isnan(row["sensor_noise"]):
        return f"{text}."
    ratio = row["residual_rms"] / row["sensor_noise"]
    if ratio < STRUCTURED:
        return f"{text}; the residual is no larger than {ratio:.1f} times the sensor noise."
    return (
        f"{text}; the residual is {ratio:.1f} times the sensor noise and its neighbouring samples correlate by "
        f"{row['lag_one_correlation']:.2f}: structured misfit remains, which the estimated noise carries as "
        "uncertainty but no parameter of this model explains."
    )
