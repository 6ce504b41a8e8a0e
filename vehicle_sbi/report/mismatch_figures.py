"""The pictures of a diagnosis: what was left over before and after, what explains it, what moved, what was held out."""

from collections.abc import Mapping
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.mismatch.answer.schema import Verdict
from vehicle_sbi.mismatch.answer.verdict import Found
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection.predictive import Prediction
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.report.figures import MEASURED, POSTERIOR, PRIOR, STYLE, TRUTH, key, save
from vehicle_sbi.report.tables import symbol, unit_symbol

MOST_BARS = 15
LEAST = 0.05  # probability of an effect that has a bar


def residuals(found: Found, answer: Verdict, path: Path) -> None:
    """Recorded less simulated per channel, smoothed over a quarter of a second, of base and extended model."""
    base, model = found.examined.fit, found.extended.model
    windows = base.simulator.windows
    alone = len(set(windows.recordings)) == 1
    t = (windows.t if alone else windows.u[..., INPUTS.index("time")]).reshape(-1)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(11.0, 1.7 * len(windows.channels) + 0.8), layout="constrained")
        axes = figure.subplots(len(windows.channels), 1, sharex=True, squeeze=False)[:, 0]
        for i, (axis, name) in enumerate(zip(axes, windows.channels, strict=True)):
            fits = {TRUTH: base} | ({POSTERIOR: model.fit} if model.effects else {})
            for color, fit in fits.items():
                rest = np.where(windows.valid[i], fit.unexplained[i], np.nan)
                axis.plot(t, rest, color=color, linewidth=0.5, alpha=0.35)
                axis.plot(t, _smooth(rest, windows.rate), color=color, linewidth=1.3)
            for place in answer.mismatch:
                if place.channel == name and not place.regime:
                    for one in place.within if alone else [place]:
                        axis.axvspan(one.from_s, one.to_s, color=PRIOR, alpha=0.7, linewidth=0, zorder=0)
            axis.set_ylabel(f"{symbol(name)} [{unit_symbol(CHANNELS[name].unit)}]")
            axis.axhline(0.0, color="#999999", linewidth=0.6)
        axes[-1].set_xlabel(f"time [s]{'' if alone else ', recordings one after another'}")
        keys = [key("base model", TRUTH), *([key("extended model", POSTERIOR)] if model.effects else [])]
        save(figure, path, [*keys, Patch(color=PRIOR, label="more than noise")])


def _smooth(values: np.ndarray, rate: float) -> np.ndarray:
    """Running mean over a quarter of a second of what is there."""
    kernel = np.ones(max(1, round(0.25 * rate)))
    known = np.isfinite(values)
    count = np.convolve(known, kernel, mode="same")
    with np.errstate(invalid="ignore"):
        mean = np.convolve(np.where(known, values, 0.0), kernel, mode="same") / count
    return np.where(known, mean, np.nan)


def probabilities(answer: Verdict, path: Path) -> None:
    """A bar for each effect that is at all likely, and one for none."""
    bars = [(name.replace("_", " "), p) for name, p in answer.effects.items() if p >= LEAST][:MOST_BARS]
    bars = [*bars, ("nothing at all", answer.p_none)]
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 0.32 * len(bars) + 0.9), layout="constrained")
        axis = figure.subplots()
        names, likely = zip(*reversed(bars), strict=True)
        axis.barh(range(len(bars)), likely, color=POSTERIOR, height=0.65)
        axis.set_yticks(range(len(bars)), names)
        for i, value in enumerate(likely):
            axis.text(value + 0.01, i, f"{value:.2f}", va="center", fontsize=8)
        axis.axvline(0.5, color="#999999", linewidth=0.6)
        axis.set_xlim(0.0, 1.1)
        axis.set_xlabel("probability")
        save(figure, path, [])


def shifts(answer: Verdict, space: ParameterSpace, path: Path) -> None:
    """Each base parameter in its prior's box, before and after, with 90 % intervals."""
    names = list(answer.base_parameters)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 0.42 * len(names) + 0.9), layout="constrained")
        axis = figure.subplots()
        for i, (name, p) in enumerate(zip(names, space.parameters, strict=True)):
            for offset, color, when in ((0.15, TRUTH, "before"), (-0.15, POSTERIOR, "after")):
                value = answer.base_parameters[name][when]  # pyright: ignore[reportIndexIssue]
                at, half = (value["mean"] - p.low) / (p.high - p.low), 1.645 * value["std"] / (p.high - p.low)
                axis.errorbar(at, -i + offset, xerr=half, color=color, marker="o", markersize=4, capsize=3)
        axis.set_yticks([-i for i in range(len(names))], [symbol(name) for name in names])
        axis.set_xlim(-0.02, 1.02)
        axis.set_xticks([0, 0.5, 1], ["prior's low end", "", "prior's high end"])
        save(figure, path, [key("base model", TRUTH), key("whatever is missing", POSTERIOR)])


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
