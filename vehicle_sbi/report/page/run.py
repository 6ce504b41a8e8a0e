"""The page of a run: which parameters the recording told, their posteriors, and how they predict the recording."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Float

from vehicle_sbi.data.windows import Windows
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.report.density import density_in_box
from vehicle_sbi.report.figures import KDE_SAMPLES
from vehicle_sbi.report.page.charts import chart
from vehicle_sbi.report.page.page import Page
from vehicle_sbi.report.page.parts import Curves, Interval, Listed, Picture, Range, Ranges, Section, Table, raised, unit
from vehicle_sbi.report.page.series import series
from vehicle_sbi.report.tables.posterior import NOT_IDENTIFIED, NOT_LEARNED, unidentified
from vehicle_sbi.report.tables.symbols import minus
from vehicle_sbi.report.tables.text import LEGEND, for_people
from vehicle_sbi.rounding import mean_and_std

POINTS = 200  # of a density
SPELLED = 8  # parameters whose values the lines spell out at most
LABELS = {"recorded": "recorded", "extended": "predicted median"}
OF_CURVES = "Recorded signals over the band that holds 90 % of the predictions. What leaves the band, the model lacks."
OF_RANGES = "The posterior of each parameter within its prior's box. A peak was told by the recording; grey was not."


def page_of(
    name: str,
    space: ParameterSpace,
    samples: Float[np.ndarray, "n d"],
    table: pd.DataFrame,
    recorded: tuple[Windows, Float[np.ndarray, "channels time"], Float[np.ndarray, "3 channels time"]],
    *,
    path: Path,
    figures: Mapping[str, Path],
    notes: Sequence[str],
    warnings: Sequence[str],
) -> Page:
    """`recorded` are windows, measurements and the quantiles of their predictions; `figures` go by caption."""
    return Page(
        title=f"Parameters of {name}",
        headline=headline(table, alone=recorded[0].alone),
        lines=lines(table),
        warnings=warnings,
        shown=[
            Section(heading="Parameters", said=OF_RANGES, parts=[_posteriors(space, samples, table)]),
            Section(heading="Recorded and predicted", said=OF_CURVES, parts=[_predicted(*recorded)]),
        ],
        folded=[
            Section(heading="Table", parts=[Table(for_people(table), LEGEND)]),
            *(
                Section(heading=caption.split(":")[0].rstrip("."), parts=[Picture(file, caption, path)])
                for caption, file in figures.items()
            ),
            *([Section(heading="Notes", parts=[Listed(notes)])] if notes else []),
        ],
    )


def headline(table: pd.DataFrame, *, alone: bool = True) -> str:
    """How many parameters the recording, or several of them, told."""
    known, total = int(table["identified"].sum()), len(table)
    identify = "The recording identifies" if alone else "The recordings identify"
    if known == total:
        return f"{identify} {'the parameter' if total == 1 else f'all {total} parameters'}."
    return f"{identify} {known or 'none'} of {total} parameter{'s' if total > 1 else ''}."


def lines(table: pd.DataFrame) -> list[str]:
    """The values of parameters that are identified, and the names of those that are not."""
    known = table["identified"].to_numpy(dtype=bool)
    rows = table[["parameter", "mean", "std", "unit"]].to_numpy()[known].tolist()
    values = [f"{name} = {_value(mean, std, of)}" for name, mean, std, of in rows]
    more = [f"and {len(values) - SPELLED} more"] if len(values) > SPELLED else []
    said = [raised(f"{'; '.join([*values[:SPELLED], *more])}.")] if values else []
    reasons = np.array(unidentified(table))
    unknown = {why: table["parameter"][reasons == why] for why in (NOT_IDENTIFIED, NOT_LEARNED)}
    return [*said, *(f"{why.capitalize()}: {', '.join(names)}." for why, names in unknown.items() if len(names))]


def _value(mean: float, std: float, of: str) -> str:
    """A value with its unit; in brackets where that is a power of ten."""
    value = minus(mean_and_std(mean, std))
    return f"({value}) · {of}" if of.startswith("1e") else f"{value} {of}".removesuffix(" 1")


def _posteriors(space: ParameterSpace, samples: Float[np.ndarray, "n d"], table: pd.DataFrame) -> Ranges:
    thin = samples[:: max(1, len(samples) // KDE_SAMPLES)]
    rows = table.to_dict("records")
    told = zip(space.parameters, thin.T, rows, unidentified(table), strict=True)
    ranges = [_range(p, x, row, remark) for p, x, row, remark in told]
    keys = {"extended": "posterior, 90 % interval", "prior": "prior"}
    return Ranges(ranges, keys | ({} if table["true"].isna().all() else {"true": "true value"}))


def _range(p: Parameter, x: Float[np.ndarray, " n"], row: Mapping, remark: str) -> Range:
    grid = np.linspace(p.low, p.high, POINTS)[:, None]
    said = minus(mean_and_std(row["mean"], row["std"]))
    return Range(
        name=p.name,
        unit=unit(p),
        low=p.low,
        high=p.high,
        intervals=[Interval("extended", row["q05"], row["mean"], row["q95"], said)],
        density=density_in_box(x[:, None], grid, np.array([p.low]), np.array([p.high])),
        true=None if np.isnan(row["true"]) else row["true"],
        remark=remark,
    )


def _predicted(windows: Windows, measured: np.ndarray, quantiles: np.ndarray) -> Curves:
    low, middle, high = quantiles
    figure, every = chart(series(windows, {"recorded": measured, "extended": middle}, band=(low, high)), LABELS)
    keys = {**LABELS, "band": "90 % of predictions"}
    return Curves(figure, keys, "Recorded signals and the posterior's predictions", every)
