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
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter
from scipy.stats import gaussian_kde

from vehicle_sbi.files import write_atomically
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.report.tables import NOT_IDENTIFIED, mean_and_std, symbol, unit_symbol

MEASURED, POSTERIOR, TRUTH, BOUND, PRIOR = "#333333", "#2b6ca3", "#c8322b", "#c98a13", "#d9d9d9"
STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "axes.titlesize": 9.0,
    "axes.labelsize": 9.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": "#888888",
    "axes.linewidth": 0.8,
    "xtick.labelsize": 7.5,
    "ytick.labelsize": 7.5,
    "xtick.color": "#555555",
    "ytick.color": "#555555",
    "legend.frameon": False,
    "legend.fontsize": 8.5,
    "figure.facecolor": "white",
}
DPI = 150
KDE_SAMPLES = 1000  # a density on a screen needs no more, and its cost grows with them
MASSES = (0.95, 0.8, 0.6, 0.4, 0.2)  # shares of the posterior inside the filled contours
_BLUES = LinearSegmentedColormap.from_list("posterior", ("#dbe9f5", POSTERIOR, "#123a5c"))


def _save(figure: Figure, path: Path) -> None:
    write_atomically(path, lambda file: figure.savefig(file, format="png", dpi=DPI, metadata={"Software": None}))


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
                _joint(axis, thinned[:, pair], space.low[pair], space.high[pair], spans[column], spans[row])
                axis.plot(*truth[pair], "o", color=TRUTH, markersize=4.5, markeredgecolor="white", markeredgewidth=0.6)
            else:
                _correlation(axis, correlation[row, column])
            _label(axis, space, row, column)
        figure.align_labels()
        zoomed = any(a > p.low or b < p.high for (a, b), p in zip(spans, space.parameters, strict=True))
        handles = _pairplot_legend(true is not None, zoomed)
        figure.legend(handles=handles, loc="outside upper center", ncols=len(handles) if d > 4 else 2)
        _save(figure, path)


def _span(x: Float[np.ndarray, " n"], low: float, high: float, true: float) -> tuple[float, float]:
    """Limits of an axis: the prior with a margin, or what holds posterior and truth where they are narrow in it."""
    first, last = np.nanmin([np.quantile(x, 0.001), true]), np.nanmax([np.quantile(x, 0.999), true])
    if last - first > 0.35 * (high - low):
        margin = 0.04 * (high - low)
        return low - margin, high + margin
    half = 0.75 * max(last - first, 1e-6 * (high - low))
    middle = (first + last) / 2.0
    return max(middle - half, low - 0.15 * half), min(middle + half, high + 0.15 * half)


def _marginal(axis: Axes, x: Float[np.ndarray, " n"], p: Parameter, span: tuple[float, float], true: float) -> None:
    grid = np.linspace(max(span[0], p.low), min(span[1], p.high), 200)
    density = _density(x[:, None], grid[:, None], np.array([p.low]), np.array([p.high]))
    axis.fill_between(grid, density, color=POSTERIOR, alpha=0.25, linewidth=0)
    axis.plot(grid, density, color=POSTERIOR, linewidth=1.4)
    level = 1.0 / (p.high - p.low)
    axis.plot([p.low, p.low, p.high, p.high], [0.0, level, level, 0.0], color="#999999", linewidth=0.9, linestyle="--")
    if np.isfinite(true):
        axis.axvline(true, color=TRUTH, linewidth=1.4)
    axis.set_xlim(span)
    axis.set_ylim(0.0, 1.25 * max(density.max(), level))
    axis.set_yticks([])
    axis.spines["left"].set_visible(False)
    if span[0] > p.low or span[1] < p.high:
        _place_in_prior(axis, p, span)


def _place_in_prior(axis: Axes, p: Parameter, span: tuple[float, float]) -> None:
    """A strip at the top of a zoomed panel: the prior's range in grey, the part of it that the panel shows in blue."""
    strip = axis.inset_axes((0.0, 0.94, 1.0, 0.06), zorder=3)
    strip.axvspan(p.low, p.high, color=PRIOR, linewidth=0)
    strip.axvspan(max(span[0], p.low), min(span[1], p.high), color=POSTERIOR, linewidth=0)
    strip.set_xlim(p.low, p.high)
    strip.set_axis_off()


def _joint(
    axis: Axes,
    xy: Float[np.ndarray, "n 2"],
    low: Float[np.ndarray, "2"],
    high: Float[np.ndarray, "2"],
    x_span: tuple[float, float],
    y_span: tuple[float, float],
) -> None:
    x, y = (
        np.linspace(max(span[0], a), min(span[1], b), 60)
        for span, a, b in zip((x_span, y_span), low, high, strict=True)
    )
    points = np.stack(np.meshgrid(x, y), axis=-1)
    density = _density(xy, points.reshape(-1, 2), low, high).reshape(len(y), len(x))
    levels = np.unique([*(_level(density, mass) for mass in MASSES), 1.001 * density.max()])
    axis.contourf(x, y, density, levels=levels, cmap=_BLUES)
    for edge in (low[0], high[0]):
        axis.axvline(edge, color="#999999", linewidth=0.9, linestyle="--")
    for edge in (low[1], high[1]):
        axis.axhline(edge, color="#999999", linewidth=0.9, linestyle="--")
    axis.set_xlim(x_span)
    axis.set_ylim(y_span)


def _density(
    samples: Float[np.ndarray, "n k"],
    points: Float[np.ndarray, "m k"],
    low: Float[np.ndarray, " k"],
    high: Float[np.ndarray, " k"],
) -> Float[np.ndarray, " m"]:
    """Gaussian kernel density of samples in a box, mirrored at its faces.

    Without the mirror images a flat posterior would seem to fall off towards the bounds of its prior. Faces that no
    sample comes within four kernel widths of need none.
    """
    try:
        kde = gaussian_kde(samples.T)
    except np.linalg.LinAlgError:  # samples on a line or a point: widen them invisibly
        spread = 1e-4 * (high - low) * np.random.default_rng(0).standard_normal(samples.shape)
        kde = gaussian_kde((samples + spread).T)
    reach = 4.0 * np.sqrt(np.diag(np.atleast_2d(kde.covariance)))
    faces = [
        [None, *([a] if x.min() < a + r else []), *([b] if x.max() > b - r else [])]
        for x, a, b, r in zip(samples.T, low, high, reach, strict=True)
    ]
    images = [
        np.column_stack([x if face is None else 2.0 * face - x for x, face in zip(points.T, at, strict=True)])
        for at in product(*faces)
    ]
    return np.sum([kde(image.T) for image in images], axis=0)


def _level(density: np.ndarray, mass: float) -> float:
    """The density above which `mass` of the distribution lies."""
    falling = np.sort(density, axis=None)[::-1]
    share = np.cumsum(falling) / falling.sum()
    return float(falling[min(int(np.searchsorted(share, mass)), falling.size - 1)])


def _correlation(axis: Axes, value: float) -> None:
    axis.text(
        0.5, 0.5, f"{round(value, 2) + 0.0:.2f}".replace("-", "−"),
        transform=axis.transAxes, ha="center", va="center", fontsize=8.0 + 5.0 * abs(value), color=MEASURED,
        alpha=0.5 + 0.5 * abs(value),
    )  # fmt: skip
    axis.set_axis_off()


def _label(axis: Axes, space: ParameterSpace, row: int, column: int) -> None:
    """Names and units at the outer edge only, so that the panels stay close."""
    axis.xaxis.set_major_locator(MaxNLocator(3, steps=[1, 2, 2.5, 5, 10]))
    axis.xaxis.set_major_formatter(FuncFormatter(_tick))
    if row > column:
        axis.yaxis.set_major_formatter(FuncFormatter(_tick))
        axis.yaxis.set_major_locator(MaxNLocator(4, steps=[1, 2, 2.5, 5, 10]))
    if row == len(space) - 1:
        axis.set_xlabel(name_with_unit(space.parameters[column].name, space.parameters[column].unit))
    else:
        axis.set_xticklabels([])
    if column == 0 and row > 0:
        axis.set_ylabel(name_with_unit(space.parameters[row].name, space.parameters[row].unit))
    elif row > column:
        axis.set_yticklabels([])


def _tick(value: float, position: int | None = None) -> str:
    """A short number: a stiffness of 160000 would run into its neighbour."""
    text = f"{value / 1e3:g}k" if abs(value) >= 1e4 else f"{value:g}"
    return text.replace("-", "−")


def name_with_unit(name: str, unit: str) -> str:
    """An axis label: symbol and unit, an effect's parameter on a line of its own."""
    return symbol(name).replace(": ", ":\n") + (f" [{unit_symbol(unit)}]" if unit_symbol(unit) else "")


def _pairplot_legend(truth: bool, zoomed: bool) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [Patch(color=POSTERIOR, alpha=0.5, label="posterior")]
    if truth:
        handles.append(Line2D([], [], color=TRUTH, marker="o", markersize=4.5, label="true value"))
    handles.append(Line2D([], [], color="#999999", linestyle="--", label="prior"))
    if zoomed:
        handles.append(Patch(color=POSTERIOR, label="part of the prior shown"))
    return handles


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
        figure.legend(handles=_predictive_legend(bool(np.all(valid))), loc="outside upper center", ncols=4)
        _save(figure, path)


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
    whole_height = axis.get_xaxis_transform()
    axis.fill_between(
        t, 0, 1, where=list(masked), transform=whole_height, color=PRIOR, alpha=0.8, linewidth=0, zorder=0
    )


def _fit(axis: Axes, shown: np.ndarray) -> None:
    """Limits from what counts, so that a masked spike does not flatten the rest."""
    shown = shown[np.isfinite(shown)]
    if shown.size:
        margin = 0.06 * np.ptp(shown) or 1.0
        axis.set_ylim(shown.min() - margin, shown.max() + margin)


def _predictive_legend(all_valid: bool) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [
        Line2D([], [], color=MEASURED, linewidth=1.0, label="recorded"),
        Line2D([], [], color=POSTERIOR, label="predicted median"),
        Patch(facecolor="#bfd3e6", edgecolor=POSTERIOR, label="90 % of predictions"),
    ]
    return handles if all_valid else [*handles, Patch(color=PRIOR, label="not used")]


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
        handles = [
            Line2D([], [], color=MEASURED, linewidth=1.0, label="training"),
            Line2D([], [], color=POSTERIOR, label="validation"),
            Line2D([], [], color=POSTERIOR, marker="o", linestyle="", markerfacecolor="white", label="kept"),
        ]
        figure.legend(handles=handles, loc="outside upper center", ncols=3)
        _save(figure, path)


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
        colors = np.where(known, POSTERIOR, "#b5b5b5")
        axis.barh(at, np.maximum(share - start, 0.0), left=start, height=0.5, color=colors)
        shown = np.isfinite(bound) & (bound < 1.0)
        axis.vlines(bound[shown], at[shown] - 0.36, at[shown] + 0.36, color=BOUND, linewidth=3.0)
        axis.axvline(1.0, color="#777777", linewidth=1.0, linestyle="--")
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
        figure.legend(handles=_bars_legend(bool(known.all())), loc="outside upper center", ncols=4)
        _save(figure, path)


def _remarks(table: pd.DataFrame) -> Iterator[str]:
    for unit, mean, std, identified in table[["unit", "mean", "std", "identified"]].to_numpy():
        value, shown = mean_and_std(mean, std), unit_symbol(unit)
        quantity = f"({value}) {shown}" if shown.startswith("$10") else f"{value} {shown}"
        yield quantity if identified else NOT_IDENTIFIED


def _bars_legend(all_identified: bool) -> list[Patch | Line2D]:
    handles: list[Patch | Line2D] = [
        Patch(color=POSTERIOR, label="posterior"),
        Line2D([], [], color=BOUND, linewidth=3.0, label="Cramér-Rao bound"),
        Line2D([], [], color="#777777", linestyle="--", label="prior"),
    ]
    return handles if all_identified else [*handles, Patch(color="#b5b5b5", label="not identified")]
