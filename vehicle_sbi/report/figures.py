"""The pictures of a run: what the posterior is, what it predicts, how its networks trained, what was knowable.

One colour has one meaning everywhere: dark grey is measured, blue is the posterior, red the truth, ochre the bound,
light grey the prior or what is left out.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from itertools import product
from pathlib import Path
from typing import Any

import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import seaborn
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
from vehicle_sbi.report.tables.posterior import unidentified
from vehicle_sbi.report.tables.symbols import minus, symbol, unit_symbol
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
Shown = tuple[Parameter, Span, float]  # a parameter, the limits of its axis, its truth (NaN where it is not known)
MOST_IN_PAIRS = 10  # parameters beside each other that a screen can show
KDE_SAMPLES = 1000  # a density on a screen needs no more, and its cost grows with them
PRIOR_EDGE: dict[str, Any] = {"color": "#999999", "linewidth": 0.9, "linestyle": "--"}
NO_ANSWER = "#b5b5b5"
LOSSES = {"training": MEASURED, "validation": POSTERIOR}
MASSES = (0.95, 0.8, 0.6, 0.4, 0.2)  # shares of the posterior inside the filled contours
_BLUES = LinearSegmentedColormap.from_list("posterior", ("#dbe9f5", POSTERIOR, "#123a5c"))


@contextmanager
def _style() -> Iterator[None]:
    """The look of all pictures, of seaborn's too, for as long as one is drawn; what pyplot opens is closed again."""
    opened = {*plt.get_fignums()}
    with matplotlib.rc_context(STYLE):
        try:
            yield
        finally:
            for number in {*plt.get_fignums()} - opened:
                plt.close(number)


def save(figure: Figure, path: Path, legend: Sequence[Artist], *, columns: int = 4) -> None:
    figure.set_layout_engine("constrained")
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
    strip on the diagonal shows which part of the prior that is. Of many parameters the vehicle's constants are shown,
    and those of effects that are correlated most with any other.
    """
    shown, every = _most_correlated(samples, space), len(space)
    truth = (np.full(every, np.nan) if true is None else np.asarray(true, dtype=float))[shown]
    samples, space = samples[:, shown], ParameterSpace(tuple(space.parameters[k] for k in shown))
    d = len(space)
    thinned = pd.DataFrame(samples[:: max(1, len(samples) // KDE_SAMPLES)], columns=list(space.names))
    spans = [_span(*column) for column in zip(samples.T, space.low, space.high, truth, strict=True)]
    at = dict(zip(space.names, zip(space.parameters, spans, truth, strict=True), strict=True))
    with _style():
        grid = seaborn.PairGrid(thinned, diag_sharey=False, height=max(1.5, 4.0 / d), despine=False)
        grid.map_diag(_marginal, at=at)
        grid.map_lower(_joint, at=at)
        grid.map_upper(_correlation, of=np.atleast_2d(np.corrcoef(samples, rowvar=False)), names=space.names)
        for row, column in product(range(d), repeat=2):
            _label(grid.axes[row, column], space, row, column)
        grid.figure.align_labels()
        zoomed = any(a > p.low or b < p.high for (a, b), p in zip(spans, space.parameters, strict=True))
        keys = [
            Patch(color=POSTERIOR, alpha=0.5, label="posterior"),
            *([key("true value", TRUTH, marker="o", markersize=4.5)] if true is not None else []),
            key("prior", **PRIOR_EDGE),
            *([Patch(color=POSTERIOR, label="part of the prior shown")] if zoomed else []),
            *(
                [key(f"{d} of {every} parameters: constants, and the most correlated of effects", "none")]
                if d < every
                else []
            ),
        ]
        save(grid.figure, path, keys, columns=len(keys) if d > 4 else 2)


def _most_correlated(samples: Float[np.ndarray, "n d"], space: ParameterSpace) -> list[int]:
    """Columns of all parameters, or of MOST_IN_PAIRS: the vehicle's constants before those of effects, the most
    correlated with any other first."""
    if len(space) <= MOST_IN_PAIRS:
        return [*range(len(space))]
    related = np.nan_to_num(np.abs(np.corrcoef(samples, rowvar=False)) - np.eye(len(space)))
    of_effect = np.array(["." in name for name in space.names])
    return sorted(np.lexsort((-related.max(axis=0), of_effect))[:MOST_IN_PAIRS].tolist())


def _span(x: Float[np.ndarray, " n"], low: float, high: float, true: float) -> Span:
    """Limits of an axis: the prior with a margin, or what holds posterior and truth where they are narrow in it."""
    first, last = np.nanmin([np.quantile(x, 0.001), true]), np.nanmax([np.quantile(x, 0.999), true])
    if last - first > 0.35 * (high - low):
        margin = 0.04 * (high - low)
        return low - margin, high + margin
    half = 0.75 * max(last - first, 1e-6 * (high - low))
    middle = (first + last) / 2.0
    return max(middle - half, low - 0.15 * half), min(middle + half, high + 0.15 * half)


def _marginal(x: pd.Series, *, at: Mapping[str, Shown], **_: object) -> None:
    """A histogram, which unlike a kernel density does not fall off towards the bounds of the prior."""
    axis, (p, span, true) = plt.gca(), at[str(x.name)]
    seaborn.histplot(x=x, stat="density", element="step", binrange=_seen(p, span), color=POSTERIOR, alpha=0.3, ax=axis)
    level = 1.0 / (p.high - p.low)
    axis.plot([p.low, p.low, p.high, p.high], [0.0, level, level, 0.0], **PRIOR_EDGE)
    if np.isfinite(true):
        axis.axvline(true, color=TRUTH, linewidth=1.4)
    axis.set(xlim=span, ylim=(0.0, 1.25 * max(axis.dataLim.ymax, level)))
    if span[0] > p.low or span[1] < p.high:
        _place_in_prior(axis, p, span)


def _seen(p: Parameter, span: Span) -> Span:
    """The part of the prior that an axis shows."""
    return max(span[0], p.low), min(span[1], p.high)


def _place_in_prior(axis: Axes, p: Parameter, span: Span) -> None:
    """A strip at the top of a zoomed panel: the prior's range in grey, the part of it that the panel shows in blue."""
    strip = axis.inset_axes((0.0, 0.94, 1.0, 0.06), zorder=3)
    strip.axvspan(p.low, p.high, color=PRIOR, linewidth=0)
    strip.axvspan(*_seen(p, span), color=POSTERIOR, linewidth=0)
    strip.set_xlim(p.low, p.high)
    strip.set_axis_off()


def _joint(x: pd.Series, y: pd.Series, *, at: Mapping[str, Shown], **_: object) -> None:
    """Filled contours of a kernel density that keeps its mass inside the prior, which seaborn's does not."""
    axis, pair = plt.gca(), [at[str(one.name)] for one in (x, y)]
    low, high = np.array([p.low for p, *_ in pair]), np.array([p.high for p, *_ in pair])
    across, up = (np.linspace(*_seen(p, span), 60) for p, span, _ in pair)
    points = np.stack(np.meshgrid(across, up), axis=-1)
    density = density_in_box(np.column_stack([x, y]), points.reshape(-1, 2), low, high).reshape(len(up), len(across))
    levels = np.unique([*(level_of(density, mass) for mass in MASSES), 1.001 * density.max()])
    axis.contourf(across, up, density, levels=levels, cmap=_BLUES)
    for left, lower in (low, high):
        axis.axvline(left, **PRIOR_EDGE)
        axis.axhline(lower, **PRIOR_EDGE)
    true = [[value] for *_, value in pair]
    axis.plot(*true, "o", color=TRUTH, markersize=4.5, markeredgecolor="white", markeredgewidth=0.6)
    axis.set(xlim=pair[0][1], ylim=pair[1][1])


def _correlation(x: pd.Series, y: pd.Series, *, of: np.ndarray, names: Sequence[str], **_: object) -> None:
    axis, value = plt.gca(), of[names.index(str(x.name)), names.index(str(y.name))]
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
    axis.tick_params(labelbottom=last, labelleft=first, left=row != column)
    axis.spines["left"].set_visible(row != column)


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
    each = [_loss_curves(k, m, one) for k, round in enumerate(history, 1) for m, one in enumerate(round)]
    curves = pd.concat(each, ignore_index=True)
    columns = min(len(history), 5)
    with _style():
        grid = seaborn.relplot(
            curves, x="epoch", y="loss", hue="loss of", units="member", estimator=None, col="round", kind="line",
            col_wrap=columns, height=2.6, aspect=max(2.3, 4.5 / columns) / 2.6, palette=LOSSES, linewidth=1.2,
            facet_kws={"sharex": False, "sharey": False}, legend=False,
        )  # fmt: skip
        grid.map_dataframe(_mark_kept)
        grid.set_titles("").set_titles("round {col_name}", loc="left")
        for axis in grid.axes.flat:
            axis.xaxis.set_major_locator(MaxNLocator(4, integer=True))
        kept = key("kept", POSTERIOR, marker="o", linestyle="", markerfacecolor="white")
        save(grid.figure, path, [*(key(name, color) for name, color in LOSSES.items()), kept])


def _loss_curves(number: int, member: int, summary: Mapping[str, Sequence[float]]) -> pd.DataFrame:
    """Both losses of a member of the ensemble, a row an epoch."""
    parts = []
    for name in LOSSES:
        loss = np.asarray(summary[f"{name}_loss"], dtype=float)
        parts.append(pd.DataFrame({"epoch": np.arange(1, len(loss) + 1), "loss": loss, "loss of": name}))
    return pd.concat(parts).assign(round=number, member=member)


def _mark_kept(data: pd.DataFrame, **_: object) -> None:
    """A ring at the epoch whose network was kept."""
    for _member, one in data[data["loss of"] == "validation"].dropna(subset="loss").groupby("member"):
        best = one.loc[one["loss"] == one["loss"].min()].iloc[:1]
        plt.gca().plot(best["epoch"], best["loss"], "o", color=POSTERIOR, markerfacecolor="white", markersize=5.0)


def contraction_bars(table: pd.DataFrame, path: Path) -> None:
    """Posterior standard deviation of each parameter beside its bound and its prior, all in units of the prior's.

    `table` as of `posterior_table`. A parameter that is not identified is grey.
    """
    prior = (table["prior_high"] - table["prior_low"]).to_numpy() / np.sqrt(12.0)
    share, bound = (table[name].to_numpy() / prior for name in ("std", "bound_std"))
    shares = pd.DataFrame(
        {
            "parameter": [symbol(name) for name in table["parameter"]],
            "posterior": share,
            "bound": np.where(bound < 1.0, bound, np.nan),
            "identified": table["identified"].astype(bool),
        }
    )
    with _style():
        figure = Figure(figsize=(8.0, 0.42 * len(table) + 1.3), layout="constrained")
        axis = figure.subplots()
        look: dict[str, Any] = {
            "data": shares,
            "y": "parameter",
            "orient": "y",
            "linestyle": "none",
            "errorbar": None,
            "ax": axis,
        }
        seaborn.pointplot(
            x="posterior", hue="identified", palette={True: POSTERIOR, False: NO_ANSWER}, legend=False, **look
        )
        if shares["bound"].notna().any():
            seaborn.pointplot(x="bound", color=BOUND, marker="|", markersize=14.0, markeredgewidth=3.0, **look)
        axis.axvline(1.0, **PRIOR_EDGE)
        axis.set(xscale="log", ylabel="", xlabel="standard deviation / prior's standard deviation")
        least = np.nanmin(np.concatenate([share[share > 0.0], bound[bound > 0.0], [0.5]]))
        axis.set_xlim(0.7 * least, max(1.3, 1.1 * share.max()))
        axis.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
        axis.xaxis.set_major_formatter(FuncFormatter(_tick))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.yaxis.grid(True, color="#e6e6e6")
        axis.tick_params(axis="y", length=0, labelsize=9.0)
        axis.spines["left"].set_visible(False)
        for height, text in enumerate(_remarks(table)):
            axis.annotate(text, (1.02, height), xycoords=("axes fraction", "data"), va="center", fontsize=8.5)
        point: dict[str, Any] = {"marker": "o", "linestyle": ""}
        keys = [
            key("posterior", POSTERIOR, **point),
            key("Cramér-Rao bound", BOUND, linewidth=3.0),
            key("prior", **PRIOR_EDGE),
            *([] if shares["identified"].all() else [key("not identified", NO_ANSWER, **point)]),
        ]
        save(figure, path, keys)


def _remarks(table: pd.DataFrame) -> Iterator[str]:
    for (unit, mean, std), why in zip(table[["unit", "mean", "std"]].to_numpy(), unidentified(table), strict=True):
        value, shown = minus(mean_and_std(mean, std)), unit_symbol(unit)
        quantity = f"({value}) {shown}" if shown.startswith("$10") else f"{value} {shown}"
        yield why or quantity
