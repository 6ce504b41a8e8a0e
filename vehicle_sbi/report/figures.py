"""The pictures of a run: what the posterior is, what it predicts, how its networks trained, what was knowable.

One colour has one meaning everywhere: dark grey is measured, blue is the posterior, red the truth, ochre the bound,
light grey the prior or what is left out.
"""

from collections.abc import Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from vehicle_sbi.files import write_atomically
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.report.density import density_in_box, level_of
from vehicle_sbi.report.tables import NOT_IDENTIFIED, minus, symbol, unit_symbol
from vehicle_sbi.rounding import mean_and_std

MEASURED, POSTERIOR, TRUTH, BOUND, PRIOR = "#333333", "#2b6ca3", "#c8322b", "#c98a13", "#d9d9d9"
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "legend.fontsize": 8.5,
    "legend.frameon": False,
    "axes.edgecolor": "#888888",
    "figure.facecolor": "white",
    **dict.fromkeys(("axes.titlesize", "axes.labelsize"), 9.0),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right"), False),
    **dict.fromkeys(("xtick.labelsize", "ytick.labelsize"), 7.5),
    **dict.fromkeys(("xtick.color", "ytick.color"), "#555555"),
}
DPI = 150
Span = tuple[float, float]  # limits of an axis
KDE_SAMPLES = 1000  # a density on a screen needs no more, and its cost grows with them
PRIOR_EDGE: dict[str, Any] = {"color": "#999999", "linewidth": 0.9, "linestyle": "--"}
NO_ANSWER = "#b5b5b5"
MASSES = (0.95, 0.8, 0.6, 0.4, 0.2)  # shares of the posterior inside the filled contours
_BLUES = LinearSegmentedColormap.from_list("posterior", ("#dbe9f5", POSTERIOR, "#123a5c"))


def save(figure: Figure, path: Path, legend: Sequence[Artist], *, columns: int = 4) -> None:
    figure.legend(handles=list(legend), loc="outside upper center", ncols=columns)
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None}))


def key(label: str, color: str, **style: Any) -> Line2D:
    return Line2D([], [], color=color, label=label, **style)


def pairplot(
    samples: Float[np.ndarray, "n d"],
    space: ParameterSpace,
    true: Float[np.ndarray, " d"] | None,
    path: Path,
) -> None:
    """Marginals on the diagonal, filled contours below it, correlations above it, the truth in red.

    An axis spans the prior unless the posterior is so narrow that it would vanish: then it spans the posterior, and a
    strip on the diagonal shows which part of the prior that is.
    """
    d = len(space)
    truth = np.full(d, np.nan) if true is None else np.asarray(true, dtype=float)
    correlation = np.atleast_2d(np.corrcoef(samples, rowvar=False))
    thinned = samples[:: max(1, len(samples) // KDE_SAMPLES)]
    spans = [_span(*column) for column in zip(samples.T, space.low, space.high, truth, strict=True)]
    with matplotlib.rc_context(STYLE):
        size = max(1.5 * d + 0.6, 4.0)
        figure = Figure(figsize=(size, size), layout="constrained")
        axes = figure.subplots(d, d, squeeze=False)
        for row, column in product(range(d), repeat=2):
            axis = axes[row, column]
            if row == column:
                _marginal(axis, thinned[:, row], space.parameters[row], spans[row], truth[row])
            elif row > column:
                pair = [column, row]
                _joint(axis, thinned[:, pair], [space.parameters[k] for k in pair], [spans[k] for k in pair])
                axis.plot(*truth[pair], "o", color=TRUTH, markersize=4.5, markeredgecolor="white", markeredgewidth=0.6)
            else:
                _correlation(axis, correlation[row, column])
            _label(axis, space, row, column)
        figure.align_labels()
        zoomed = any(a > p.low or b < p.high for (a, b), p in zip(spans, space.parameters, strict=True))
        keys = [
            Patch(color=POSTERIOR, alpha=0.5, label="posterior"),
            *([key("true value", TRUTH, marker="o", markersize=4.5)] if true is not None else []),
            key("prior", **PRIOR_EDGE),
            *([Patch(color=POSTERIOR, label="part of the prior shown")] if zoomed else []),
        ]
        save(figure, path, keys, columns=len(keys) if d > 4 else 2)


def _span(x: Float[np.ndarray, " n"], low: float, high: float, true: float) -> Span:
    """Limits of an axis: the prior with a margin, or what holds posterior and truth where they are narrow in it."""
    first, last = np.nanmin([np.quantile(x, 0.001), true]), np.nanmax([np.quantile(x, 0.999), true])
    if last - first > 0.35 * (high - low):
        margin = 0.04 * (high - low)
        return low - margin, high + margin
    half = 0.75 * max(last - first, 1e-6 * (high - low))
    middle = (first + last) / 2.0
    return max(middle - half, low - 0.15 * half), min(middle + half, high + 0.15 * half)


def _marginal(axis: Axes, x: Float[np.ndarray, " n"], p: Parameter, span: Span, true: float) -> None:
    grid = np.linspace(max(span[0], p.low), min(span[1], p.high), 200)
    density = density_in_box(x[:, None], grid[:, None], np.array([p.low]), np.array([p.high]))
    axis.fill_between(grid, density, color=POSTERIOR, alpha=0.25, linewidth=0)
    axis.plot(grid, density, color=POSTERIOR, linewidth=1.4)
    level = 1.0 / (p.high - p.low)
    axis.plot([p.low, p.low, p.high, p.high], [0.0, level, level, 0.0], **PRIOR_EDGE)
    if np.isfinite(true):
        axis.axvline(true, color=TRUTH, linewidth=1.4)
    axis.set(xlim=span, ylim=(0.0, 1.25 * max(density.max(), level)), yticks=[])
    axis.spines["left"].set_visible(False)
    if span[0] > p.low or span[1] < p.high:
        _place_in_prior(axis, p, span)


def _place_in_prior(axis: Axes, p: Parameter, span: Span) -> None:
    """A strip at the top of a zoomed panel: the prior's range in grey, the part of it that the panel shows in blue."""
    strip = axis.inset_axes((0.0, 0.94, 1.0, 0.06), zorder=3)
    strip.axvspan(p.low, p.high, color=PRIOR, linewidth=0)
    strip.axvspan(max(span[0], p.low), min(span[1], p.high), color=POSTERIOR, linewidth=0)
    strip.set_xlim(p.low, p.high)
    strip.set_axis_off()


def _joint(axis: Axes, xy: Float[np.ndarray, "n 2"], pair: Sequence[Parameter], spans: Sequence[Span]) -> None:
    low, high = np.array([p.low for p in pair]), np.array([p.high for p in pair])
    x, y = (np.linspace(max(a, p.low), min(b, p.high), 60) for (a, b), p in zip(spans, pair, strict=True))
    points = np.stack(np.meshgrid(x, y), axis=-1)
    density = density_in_box(xy, points.reshape(-1, 2), low, high).reshape(len(y), len(x))
    levels = np.unique([*(level_of(density, mass) for mass in MASSES), 1.001 * density.max()])
    axis.contourf(x, y, density, levels=levels, cmap=_BLUES)
    for left, lower in (low, high):
        axis.axvline(left, **PRIOR_EDGE)
        axis.axhline(lower, **PRIOR_EDGE)
    axis.set(xlim=spans[0], ylim=spans[1])


def _correlation(axis: Axes, value: float) -> None:
    axis.text(
        0.5, 0.5, minus(f"{round(value, 2) + 0.0:.2f}"),
        transform=axis.transAxes, ha="center", va="center", fontsize=8.0 + 5.0 * abs(value), color=MEASURED,
        alpha=0.5 + 0.5 * abs(value),
    )  # fmt: skip
    axis.set_axis_off()


def _label(axis: Axes, space: ParameterSpace, row: int, column: int) -> None:
    """Names and units at the outer edge only, so that the panels stay close."""
    for one, ticks in ((axis.xaxis, 3), *([(axis.yaxis, 4)] if row > column else [])):
        one.set_major_locator(MaxNLocator(ticks, steps=[1, 2, 2.5, 5, 10]))
        one.set_major_formatter(FuncFormatter(_tick))
    names = [_name_with_unit(p) for p in space.parameters]
    last, first = row == len(space) - 1, column == 0 and row > 0
    axis.set(xlabel=names[column] if last else "", ylabel=names[row] if first else "")
    axis.tick_params(labelbottom=last, labelleft=first)


def _tick(value: float, position: int | None = None) -> str:
    """A short number: a stiffness of 160000 would run into its neighbour."""
    return minus(f"{value / 1e3:g}k" if abs(value) >= 1e4 else f"{value:g}")


def _name_with_unit(p: Parameter) -> str:
    """An axis label: symbol and unit, an effect's parameter on a line of its own."""
    return symbol(p.name).replace(": ", ":\n") + (f" [{unit_symbol(p.unit)}]" if unit_symbol(p.unit) else "")


def predictive(
    t: Float[np.ndarray, "windows time"],
    measured: Float[np.ndarray, "channels samples"],
    quantiles: Float[np.ndarray, "3 channels samples"],
    valid: Bool[np.ndarray, "channels samples"],
    channels: Sequence[str],
    units: Sequence[str],
    path: Path,
) -> None:
    """Per channel the recording and the 5, 50 and 95 % quantiles of the posterior predictive, and what is left over.

    Samples run through the windows one after the other (samples = windows * time); those not valid are shaded and count
    neither for the coverage in the title nor for the range of the axis.
    """
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 1.6 * len(channels) + 0.9), layout="constrained")
        axes = figure.subplots(len(channels), 2, sharex=True, squeeze=False, width_ratios=(1.7, 1.0))
        broken_t = _broken(t.ravel(), t.shape)
        for channel, (name, unit) in enumerate(zip(channels, units, strict=True)):
            low, middle, high = quantiles[:, channel]
            y, used = measured[channel], valid[channel] & np.isfinite(measured[channel])
            inside = (y >= low) & (y <= high)
            share = f"{inside[used].mean():.0%}".replace("%", " %") if used.any() else "nothing"
            left, right = axes[channel]
            left.set_title(f"{symbol(name)}: {share} inside the 90 % band", loc="left")
            left.set_ylabel(f"[{unit_symbol(unit) or '1'}]")
            right.set_title(f"{symbol(name)}: recorded − predicted median", loc="left")
            for axis, shift in ((left, 0.0), (right, middle)):
                curves = [_broken(curve - shift, t.shape) for curve in (y, low, middle, high)]
                _band(axis, broken_t, *curves)
                _shade(axis, broken_t, _broken((~used).astype(float), t.shape) != 0.0)
                _fit(axis, np.concatenate([(curve - shift)[used] for curve in (y, low, high)]))
        for axis in axes[-1]:
            axis.set_xlabel("time [s]")
            axis.margins(x=0.01)
        figure.align_ylabels(axes[:, 0])
        keys = [
            key("recorded", MEASURED, linewidth=1.0),
            key("predicted median", POSTERIOR),
            Patch(facecolor="#bfd3e6", edgecolor=POSTERIOR, label="90 % of predictions"),
            *([] if np.all(valid) else [Patch(color=PRIOR, label="not used")]),
        ]
        save(figure, path, keys)


def _broken(values: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Windows one after the other with a NaN between them, so that no line joins them."""
    return np.pad(values.reshape(shape), ((0, 0), (0, 1)), constant_values=np.nan).ravel()


def _band(axis: Axes, t: np.ndarray, y: np.ndarray, low: np.ndarray, middle: np.ndarray, high: np.ndarray) -> None:
    axis.fill_between(t, low, high, color=POSTERIOR, alpha=0.3, linewidth=0)
    axis.plot(t, y, color=MEASURED, linewidth=0.5, alpha=0.85)
    for edge in (low, high):  # over the recording, whose noise would hide the band
        axis.plot(t, edge, color=POSTERIOR, linewidth=0.8)
    axis.plot(t, middle, color=POSTERIOR, linewidth=1.4)


def _shade(axis: Axes, t: np.ndarray, masked: np.ndarray) -> None:
    look: dict[str, Any] = {"color": PRIOR, "alpha": 0.8, "linewidth": 0, "zorder": 0}
    axis.fill_between(t, 0, 1, where=list(masked), transform=axis.get_xaxis_transform(), **look)


def _fit(axis: Axes, shown: np.ndarray) -> None:
    """Limits from what counts, so that a masked spike does not flatten the rest."""
    shown = shown[np.isfinite(shown)]
    if shown.size:
        margin = 0.06 * np.ptp(shown) or 1.0
        axis.set_ylim(shown.min() - margin, shown.max() + margin)


def losses(history: Sequence[Sequence[Mapping[str, Sequence[float]]]], path: Path) -> None:
    """Training and validation loss per epoch, a panel per round, a pair of curves per member of the ensemble.

    `history` holds per round and member sbi's summary (`training_loss`, `validation_loss`); a ring marks the epoch
    whose network was kept. Losses of different rounds are not comparable, so each panel has its own scale.
    """
    columns = min(len(history), 5)
    rows = -(-len(history) // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(max(2.3 * columns, 4.5), 2.2 * rows + 0.6), layout="constrained")
        axes = figure.subplots(rows, columns, squeeze=False).ravel()
        for number, (axis, members) in enumerate(zip(axes, history, strict=False), start=1):
            for member in members:
                _loss_curves(axis, member)
            axis.set_title(f"round {number}", loc="left")
            axis.set_xlabel("epoch")
            axis.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        for axis in axes[::columns]:
            axis.set_ylabel("loss")
        for axis in axes[len(history) :]:
            axis.set_axis_off()
        keys = [
            key("training", MEASURED, linewidth=1.0),
            key("validation", POSTERIOR),
            key("kept", POSTERIOR, marker="o", linestyle="", markerfacecolor="white"),
        ]
        save(figure, path, keys)


def _loss_curves(axis: Axes, member: Mapping[str, Sequence[float]]) -> None:
    validation = np.asarray(member["validation_loss"], dtype=float)
    training = np.asarray(member["training_loss"], dtype=float)
    axis.plot(np.arange(1, len(training) + 1), training, color=MEASURED, linewidth=0.9, alpha=0.8)
    axis.plot(np.arange(1, len(validation) + 1), validation, color=POSTERIOR, linewidth=1.3)
    if np.isfinite(validation).any():
        best = int(np.nanargmin(validation))
        axis.plot(best + 1, validation[best], "o", color=POSTERIOR, markerfacecolor="white", markersize=5.0)


def contraction_bars(table: pd.DataFrame, path: Path) -> None:
    """Posterior standard deviation of each parameter between its bound and its prior, all in units of the prior's.

    `table` as of `posterior_table`. A parameter that is not identified is grey.
    """
    prior = (table["prior_high"] - table["prior_low"]) / np.sqrt(12.0)
    share = (table["std"] / prior).to_numpy()
    bound = (table["bound_std"] / prior).to_numpy()
    known = table["identified"].to_numpy(dtype=bool)
    at = np.arange(len(table))[::-1]
    smallest = np.nanmin(np.concatenate([share[share > 0.0], bound[bound > 0.0], [0.5]]))
    start = 10.0 ** np.floor(np.log10(0.8 * smallest))
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 0.42 * len(table) + 1.3), layout="constrained")
        axis = figure.subplots()
        axis.set_xscale("log")
        colors = np.where(known, POSTERIOR, NO_ANSWER)
        axis.barh(at, np.maximum(share - start, 0.0), left=start, height=0.5, color=colors)
        shown = np.isfinite(bound) & (bound < 1.0)
        axis.vlines(bound[shown], at[shown] - 0.36, at[shown] + 0.36, color=BOUND, linewidth=3.0)
        axis.axvline(1.0, **PRIOR_EDGE)
        axis.set_xlim(start, max(1.3, 1.1 * share.max()))
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(FuncFormatter(_tick))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_yticks(at, [symbol(name) for name in table["parameter"]], fontsize=9.0)
        axis.tick_params(axis="y", length=0)
        axis.spines["left"].set_visible(False)
        axis.set_xlabel("standard deviation / prior's standard deviation")
        for height, text in zip(at, _remarks(table), strict=True):
            axis.annotate(text, (1.02, height), xycoords=("axes fraction", "data"), va="center", fontsize=8.5)
        keys = [
            Patch(color=POSTERIOR, label="posterior"),
            key("Cramér-Rao bound", BOUND, linewidth=3.0),
            key("prior", **PRIOR_EDGE),
            *([] if known.all() else [Patch(color=NO_ANSWER, label="not identified")]),
        ]
        save(figure, path, keys)


def _remarks(table: pd.DataFrame) -> Iterator[str]:
    for unit, mean, std, identified in table[["unit", "mean", "std", "identified"]].to_numpy():
        value, shown = minus(mean_and_std(mean, std)), unit_symbol(unit)
        quantity = f"({value}) {shown}" if shown.startswith("$10") else f"{value} {shown}"
        yield quantity if identified else NOT_IDENTIFIED
