"""The numbers of a run: posterior beside prior and bound.

A parameter counts as identified when the recording both could have told (its Cramér-Rao bound is below the prior's
standard deviation) and did tell (the posterior is narrower than the prior). Numbers keep full precision here.
"""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from vehicle_sbi.errors import InputError
from vehicle_sbi.parameters import ParameterSpace

COLUMNS = (
    "parameter", "unit", "prior_low", "prior_high", "true", "mean", "std", "q05", "q50", "q95",
    "bound_std", "contraction", "identified",
)  # fmt: skip
WIDENED = ("bound_std_alone", "bound_widened", "std_over_bound_alone")  # with plausible effects free
NOT_IDENTIFIED = "not identified by this recording"
NOT_LEARNED = "not learned by this run"  # though the recording tells it
LEARNABLE = 0.1  # of the prior's width, a bound below which a parameter ought to have been identified
# 1 - (posterior std / prior std)^2 from which the posterior is no longer just the prior: std below 0.87 of the prior's.
# The contraction of an untouched uniform prior scatters by 0.03 over 1000 samples, so chance does not reach it, and an
# estimator that is merely a little too narrow does not either.
IDENTIFIED_CONTRACTION = 0.25
EDGE = 0.05  # of the prior's width, within which a median counts as lying on its edge
CERTAIN = 2.0  # standard deviations off its null, from which a size that cannot cross it is something


def on_edge(value: float, low: float, high: float, null: float | None) -> bool:
    """Whether a posterior's middle lies on an edge of a prior from low to high that could be wider.

    A bound at `null`, where an effect vanishes, could not: there is no negative delay.
    """
    margin = EDGE * (high - low)
    return (value - low < margin and low != null) or (high - value < margin and high != null)


def maybe_none(mean: float, std: float, low: float, high: float, null: float | None) -> bool:
    """Whether a size that has one side of its null alone may as well be nothing."""
    return null is not None and null in (low, high) and abs(mean - null) < CERTAIN * std


def posterior_table(
    space: ParameterSpace,
    samples: Float[np.ndarray, "n d"],
    *,
    true: Float[np.ndarray, " d"] | None = None,
    bound_std: Float[np.ndarray, " d"],
    bound_std_alone: Float[np.ndarray, " d"] | None = None,
) -> pd.DataFrame:
    """One row per parameter, `COLUMNS`; a truth that is not known is NaN, a bound where nothing is knowable inf.

    A bound that was not computed is NaN; contraction alone then decides what is identified. With the bound of a model
    without plausible effects, `bound_std_alone`, there are columns `WIDENED` too.
    """
    q05, q50, q95 = np.quantile(samples, (0.05, 0.5, 0.95), axis=0)
    std = samples.std(axis=0, ddof=1)
    contraction = 1.0 - (std / space.prior_std) ** 2
    columns = {
        "parameter": space.names,
        "unit": [p.unit for p in space.parameters],
        "prior_low": space.low,
        "prior_high": space.high,
        "true": np.full(len(space), np.nan) if true is None else np.asarray(true, dtype=float),
        "mean": samples.mean(axis=0),
        "std": std,
        "q05": q05,
        "q50": q50,
        "q95": q95,
        "bound_std": np.asarray(bound_std, dtype=float),
        "contraction": contraction,
        "identified": (contraction >= IDENTIFIED_CONTRACTION) & ~(bound_std >= space.prior_std),
    }
    table = pd.DataFrame(columns, columns=list(COLUMNS))
    return table if bound_std_alone is None else table.assign(**_widened(table, bound_std_alone))


def unidentified(table: pd.DataFrame) -> list[str]:
    """Why each parameter is not identified: the recording does not tell it, or the run has not learned it; empty where
    it is."""
    return [_why_not(row) for row in table.to_dict("records")]


def _why_not(row: Mapping) -> str:
    if row["identified"]:
        return ""
    learnable = row["bound_std"] < LEARNABLE * (row["prior_high"] - row["prior_low"])
    return NOT_LEARNED if learnable else NOT_IDENTIFIED


def _widened(table: pd.DataFrame, alone: Float[np.ndarray, " d"]) -> dict[str, np.ndarray]:
    """`WIDENED`: by which factor plausible effects widen the bound, and the posterior over the bound without them; NaN
    where the recording tells nothing even without them."""
    finite = np.where(np.isfinite(alone), alone, np.nan)
    return dict(zip(WIDENED, (alone, table["bound_std"] / finite, table["std"] / finite), strict=True))


def nominal_table(
    space: ParameterSpace, nominal: np.void | Mapping[str, float], *, noise_percent: Mapping[str, float]
) -> pd.DataFrame:
    """The paper's Table I: for every physical quantity that `space` sets its nominal value and process noise [%].

    A value has its parameter's unit (a stiffness of 1e5 N reads 1.0 in units of 1e5 N); `noise_percent` is by quantity,
    and a quantity it does not name has none.
    """
    rows = [
        (name, p.unit, float(nominal[name]) / (p.scale if p.relative else 1.0), noise_percent.get(name, np.nan))
        for p in space.parameters
        for name in p.fields
    ]
    return pd.DataFrame(rows, columns=["quantity", "unit", "nominal", "noise_percent"])


def read_table(file: Path) -> pd.DataFrame:
    """The table.csv of a finished run; InputError if it is missing or none."""
    try:
        table = pd.read_csv(file)
    except FileNotFoundError:
        raise InputError(f"{file}: missing, though the run has finished") from None
    except (pd.errors.ParserError, pd.errors.EmptyDataError, UnicodeDecodeError):
        raise InputError(f"{file}: not a table of comma-separated values") from None
    missing = [column for column in COLUMNS if column not in table]
    if missing:
        raise InputError(f"{file}: column {', '.join(missing)} missing; a run's table has {', '.join(COLUMNS)}")
    return table[list(COLUMNS)]
