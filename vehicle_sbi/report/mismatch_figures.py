"""The pictures of a diagnosis: what was left over before and after, what explains it, what moved, what was held out."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
import pandas as pd
import seaborn
from jaxtyping import Float
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.mismatch.answer.schema import Verdict
from vehicle_sbi.mismatch.answer.verdict import Found
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.predictive import Prediction
from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.report.figures import MEASURED, POSTERIOR, PRIOR, STYLE, TRUTH, key, save
from vehicle_sbi.report.tables.symbols import symbol, unit_symbol

MOST_BARS = 15
LEAST = 0.05  # probability of an effect that has a bar


def residuals(found: Found, answer: Verdict, path: Path) -> None:
    """Recorded less simulated per channel, smoothed over a quarter of a second, of base and extended model."""
    base, model = found.examined.fit, found.extended.model
    windows = base.simulator.windows
    alone, t = windows.alone, windows.clock.reshape(-1)
    fits = {TRUTH: base} | ({POSTERIOR: model.fit} if model.effects else {})
    left = {color: np.where(windows.valid, fit.unexplained, np.nan) for color, fit in fits.items()}
    slow = {color: smooth(rest, windows) for color, rest in left.items()}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 1.7 * len(windows.channels) + 0.8), layout="constrained")
        axes = figure.subplots(len(windows.channels), 1, sharex=True, squeeze=False)[:, 0]
        for i, (axis, name) in enumerate(zip(axes, windows.channels, strict=True)):
            for color, rest in left.items():
                axis.plot(t, rest[i], color=color, linewidth=0.5, alpha=0.35)
                axis.plot(t, slow[color][i], color=color, linewidth=1.3)
            for place in answer.mismatch:
                if place.channel == name and not place.regime:
                    for one in place.within if alone else [place]:
                        axis.axvspan(one.from_s, one.to_s, color=PRIOR, alpha=0.7, linewidth=0, zorder=0)
            axis.set_ylabel(f"{symbol(name)} [{unit_symbol(CHANNELS[name].unit)}]")
            axis.axhline(0.0, color="#999999", linewidth=0.6)
        axes[-1].set_xlabel(f"time [s]{'' if alone else ', recordings one after another'}")
        keys = [key("base model", TRUTH), *([key("extended model", POSTERIOR)] if model.effects else [])]
        save(figure, path, [*keys, Patch(color=PRIOR, label="more than noise")])


def smooth(values: Float[np.ndarray, "channels time"], windows: Windows) -> Float[np.ndarray, "channels time"]:
    """Running mean over a quarter of a second of what was measured; NaN where nothing was."""
    kernel = np.ones(max(1, round(0.25 * windows.rate)))
    sums = [np.convolve(row, kernel, mode="same") for row in np.where(windows.valid, values, 0.0)]
    counts = [np.convolve(known, kernel, mode="same") for known in windows.valid]
    return np.where(windows.valid, np.array(sums) / np.maximum(counts, 1.0), np.nan)


def probabilities(answer: Verdict, path: Path) -> None:
    """A bar for each effect that is at all likely, one for what no effect stands for, and one for nothing."""
    bars = [(name.replace("_", " "), p) for name, p in answer.effects.items() if p >= LEAST][:MOST_BARS]
    names, likely = zip(*bars, ("something unknown", answer.p_unknown), ("nothing at all", answer.p_none), strict=True)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 0.32 * len(names) + 0.9), layout="constrained")
        axis = figure.subplots()
        seaborn.barplot(x=likely, y=names, color=POSTERIOR, saturation=1.0, width=0.65, ax=axis)
        axis.bar_label(axis.containers[0], fmt="%.2f", padding=3, fontsize=8)  # pyright: ignore[reportArgumentType]
        axis.axvline(0.5, color="#999999", linewidth=0.6)
        axis.set(xlim=(0.0, 1.1), xlabel="probability")
        save(figure, path, [])


def shifts(answer: Verdict, space: ParameterSpace, path: Path) -> None:
    """Each base parameter in its prior's box, before and after, with 90 % intervals."""
    places = pd.concat([_place(p, answer.base_parameters[p.name]) for p in space.parameters], ignore_index=True)
    look: dict[str, Any] = {"markersize": 4, "linewidth": 1.6, "capsize": 0.12, "dodge": 0.3, "linestyle": "none"}
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 0.42 * len(space) + 0.9), layout="constrained")
        axis = figure.subplots()
        seaborn.pointplot(  # the median of an interval's ends and mean is the mean
            places, x="place", y="parameter", hue="model", palette=[TRUTH, POSTERIOR], orient="y",
            estimator="median", errorbar=("pi", 100), legend=False, ax=axis, **look,
        )  # fmt: skip
        axis.set(xlim=(-0.02, 1.02), xlabel="", ylabel="")
        axis.set_xticks([0, 0.5, 1], ["prior's low end", "", "prior's high end"])
        save(figure, path, [key("base model", TRUTH), key("whatever is missing", POSTERIOR)])


def _place(p: Parameter, values: Any) -> pd.DataFrame:
    """The ends of a parameter's 90 % intervals and its means, as shares of its prior's box."""
    rows = [
        {"parameter": symbol(p.name), "model": when, "place": (values[when][key] - p.low) / (p.high - p.low)}
        for when in ("before", "after")
        for key in ("q05", "mean", "q95")
    ]
    return pd.DataFrame(rows)


def held_out_figure(held_out: Observation, predictions: Mapping[str, Prediction], path: Path) -> None:
    """Held-out recordings per channel with both models' predictions and the last one's 90 % band."""
    windows = held_out.simulator.windows
    t = np.arange(windows.valid.shape[1]) / windows.rate
    last = list(predictions.values())[-1]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 1.7 * len(windows.channels) + 0.8), layout="constrained")
        axes = figure.subplots(len(windows.channels), 1, sharex=True, squeeze=False)[:, 0]
        for i, (axis, name) in enumerate(zip(axes, windows.channels, strict=True)):
            valid = windows.valid[i]
            axis.plot(t, np.where(valid, held_out.observed[i], np.nan), color=MEASURED, linewidth=0.8)
            low, high = last.y[i] - last.half_width[i], last.y[i] + last.half_width[i]
            axis.fill_between(t, low, high, where=list(valid), color=POSTERIOR, alpha=0.25, linewidth=0)
            for color, prediction in zip((TRUTH, POSTERIOR), predictions.values(), strict=False):
                axis.plot(t, np.where(valid, prediction.y[i], np.nan), color=color, linewidth=1.0)
            axis.set_ylabel(f"{symbol(name)} [{unit_symbol(CHANNELS[name].unit)}]")
        axes[-1].set_xlabel("time [s], windows one after another")
        keys = [key("recorded", MEASURED), key("base model", TRUTH)]
        keys += [key("extended model", POSTERIOR)] if len(predictions) > 1 else []
        save(figure, path, [*keys, Patch(color=POSTERIOR, alpha=0.25, label="its 90 % band")])
