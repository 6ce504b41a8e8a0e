"""Time series that can be zoomed into: a panel for each channel over one time axis, drawn by Bokeh.

Colours are only names here (`tags` of what is drawn): the page's script takes them from its style sheet, in light and
in dark, as a canvas cannot do that itself.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from bokeh.layouts import gridplot
from bokeh.models import (
    BoxAnnotation,
    BoxZoomTool,
    ColumnDataSource,
    CrosshairTool,
    DataRange1d,
    GlyphRenderer,
    GridPlot,
    HoverTool,
    Label,
    PanTool,
    Range1d,
    ResetTool,
    SaveTool,
    Span,
    Title,
    WheelZoomTool,
    ZoomInTool,
    ZoomOutTool,
)
from bokeh.plotting import figure
from jaxtyping import Float

from vehicle_sbi.report.page.thinning import Thinned, thinned

VALUES = 200_000  # of all curves of a chart: 1.1 MB on the page, 1.6 where there is but one curve
PANEL_PX, AXIS_PX = 165, 44  # height of a panel, and what the time axis adds to the last one
LEFT_PX = 52  # beside every panel, so that their times lie below each other
NAMED = 6  # recordings whose names are written where they begin, at most
LETTERS = {"text_font": "system-ui, sans-serif", "text_font_size": "12px"}
TITLE = {"text_font": LETTERS["text_font"], "text_font_style": "normal", "offset": 4}
LOW, HIGH = "low", "high"  # the edges of a band


@dataclass(frozen=True, kw_only=True)
class Series:
    """Signals of all channels over time: curves by name in the order in which they are drawn, and a band behind them.

    `places` are stretches [s] to be shaded, by channel; `starts` says at which time [s] which recording begins.
    """

    t: Float[np.ndarray, " time"]
    channels: Sequence[str]
    units: Sequence[str]
    curves: Mapping[str, Float[np.ndarray, "channels time"]]
    band: tuple[Float[np.ndarray, "channels time"], Float[np.ndarray, "channels time"]] | None = None
    places: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)
    starts: Sequence[tuple[float, str]] = ()

    @property
    def thinned(self) -> Thinned:
        """The columns of all channels, as many of their points as a page can hold."""
        whole = dict(self.curves)
        if self.band is not None:
            whole |= dict(zip((LOW, HIGH), self.band, strict=True))
        columns = {f"{name}_{i}": y for name, curve in whole.items() for i, y in enumerate(np.asarray(curve, float))}
        edges = {f"{edge}_{i}": edge == HIGH for edge in (LOW, HIGH) for i in range(len(self.channels))}
        return thinned(np.asarray(self.t, float), columns, values=VALUES, edges=edges)


def chart(series: Series, labels: Mapping[str, str]) -> tuple[GridPlot, int]:
    """The panels one below the other, and of how many samples each pair of points is the least and the largest.

    `labels` says what each curve is. Times keep every digit: those of a clock since 1970 are too long for 32 bits.
    """
    points = series.thinned
    source = ColumnDataSource({"t": points.t, **{k: y.astype(np.float32) for k, y in points.curves.items()}})
    span = time_range(series.t)
    panels = [_panel(series, source, i, labels, span) for i in range(len(series.channels))]
    grid = gridplot(
        [[panel] for panel in panels],
        sizing_mode="stretch_width",
        toolbar_location="above",
        toolbar_options={"logo": None},
    )
    return grid, points.every


def time_range(t: Float[np.ndarray, " time"]) -> Range1d:
    """The whole time with a hundredth of it beside, which no zoom leaves far behind."""
    first, last = float(np.min(t)), float(np.max(t))
    margin = 0.01 * max(last - first, 1e-3)
    return Range1d(start=first - margin, end=last + margin, bounds=(first - 5 * margin, last + 5 * margin))


def _panel(series: Series, source: ColumnDataSource, i: int, labels: Mapping[str, str], span: Range1d) -> figure:
    last, name = i == len(series.channels) - 1, series.channels[i]
    unit = series.units[i] if series.units[i] != "1" else ""
    panel = figure(
        height=PANEL_PX + (AXIS_PX if last else 0),
        sizing_mode="stretch_width",
        x_range=span,
        y_range=DataRange1d(range_padding=0.06),
        window_axis="x",  # the other axis follows what is seen
        title=Title(text=f"{name} [{unit}]" if unit else name, text_font_size="13px", **TITLE),
        x_axis_label="time [s]" if last else None,
        tools=[],
        min_border_left=LEFT_PX,
        min_border_right=12,
    )
    panel.xaxis.visible = last
    panel.yaxis.ticker.desired_num_ticks = 4  # pyright: ignore[reportAttributeAccessIssue]
    for axis in (*panel.xaxis, *panel.yaxis):
        axis.update(axis_label_text_font_style="normal", axis_label_text_font_size="13px", axis_label_standoff=6)
        axis.update(axis_label_text_font=LETTERS["text_font"], major_label_text_font=LETTERS["text_font"])
        axis.update(major_label_text_font_size="12px", minor_tick_line_color=None)
    for start, stop in series.places.get(name, ()):
        panel.add_layout(BoxAnnotation(left=start, right=stop, level="underlay", tags=["place"], name="place"))
    if series.band is not None:
        area = panel.varea("t", f"{LOW}_{i}", f"{HIGH}_{i}", source=source, fill_alpha=0.28, name="band")
        area.glyph.tags = ["band"]
    lines = list[GlyphRenderer]()
    for curve in series.curves:
        line = panel.line("t", f"{curve}_{i}", source=source, line_width=_width(curve), name=curve)
        line.glyph.tags = [curve]
        lines.append(line)
    _mark_starts(panel, series, named=i == 0)
    _equip(panel, series, i, labels, lines[:1])
    return panel


def _width(curve: str) -> float:
    return 1.1 if curve == "recorded" else 1.7


def _mark_starts(panel: figure, series: Series, *, named: bool) -> None:
    """A line where a recording begins, with its name in the first panel."""
    if len(series.starts) < 2:
        return
    for at, name in series.starts:
        panel.add_layout(Span(location=at, dimension="height", line_dash="dotted", tags=["start"], name="start"))
        if named and len(series.starts) <= NAMED:
            label = Label(x=at, y=2, y_units="screen", text=name, x_offset=4, tags=["start"], name="start")
            label.update(text_font=LETTERS["text_font"], text_font_size=LETTERS["text_font_size"])
            panel.add_layout(label)


def _equip(
    panel: figure, series: Series, i: int, labels: Mapping[str, str], pointed_at: Sequence[GlyphRenderer]
) -> None:
    """Drag to zoom into a stretch of time; the wheel turns the page, and zooms with Ctrl held down."""
    zoom = BoxZoomTool(dimensions="width")
    unit = f" {series.units[i]}" if series.units[i] != "1" else ""
    tips = [("time", "@t{0.00} s"), *((labels[c], f"@{c}_{i}{{0.0000}}{unit}") for c in series.curves)]
    hover = HoverTool(tooltips=tips, mode="vline", renderers=list(pointed_at), line_policy="nearest")
    panel.add_tools(
        zoom,
        PanTool(dimensions="width"),
        WheelZoomTool(dimensions="width", modifiers="ctrl"),
        ZoomInTool(dimensions="width"),
        ZoomOutTool(dimensions="width"),
        hover,
        CrosshairTool(dimensions="height", tags=["crosshair"]),
        SaveTool(),
        ResetTool(),
    )
    panel.toolbar.active_drag = zoom
