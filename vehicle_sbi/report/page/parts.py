"""What a page is made of: each part is data, and has a template of its own that draws it."""

import re
from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from bokeh.models import GridPlot
from jaxtyping import Float
from markupsafe import Markup

from vehicle_sbi.parameters import Parameter
from vehicle_sbi.report.figures import DPI
from vehicle_sbi.report.tables.symbols import minus
from vehicle_sbi.report.tables.text import html

CSS_PIXELS_PER_INCH = 96
PICTURE_BYTES = 1_000_000  # of a picture that is part of the page; a larger one is shown from its file


_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def raised(text: str) -> str:
    """The text with the powers of its units raised: m/s², 10⁵ N."""
    shown = re.sub(r"\b1e(\d+)(?= )", r"10^\1", text)
    return re.sub(r"\^(-?\d+)", lambda power: power[1].translate(_RAISED), shown)


def unit(p: Parameter) -> str:
    """A parameter's unit as it is read; empty for a pure number."""
    return "" if p.unit == "1" else raised(f"{p.unit} ").strip()


class Part:
    """Something that a template of its own draws."""

    template: ClassVar[str]


@dataclass(frozen=True)
class Words(Part):
    """Paragraphs."""

    template: ClassVar[str] = "words.html.j2"
    lines: Sequence[str]


@dataclass(frozen=True)
class Listed(Part):
    """A list of remarks."""

    template: ClassVar[str] = "listed.html.j2"
    lines: Sequence[str]


@dataclass(frozen=True)
class Table(Part):
    """A table of text that scrolls where it is wider than the page, with what explains it below."""

    template: ClassVar[str] = "table.html.j2"
    frame: pd.DataFrame
    legend: str = ""

    @property
    def markup(self) -> Markup:
        return Markup(html(self.frame))  # it escapes all that is in the frame


@dataclass(frozen=True)
class Curves(Part):
    """A chart of time series; `keys` says what each colour is."""

    template: ClassVar[str] = "curves.html.j2"
    figure: GridPlot
    keys: Mapping[str, str]
    label: str
    every: int = 1
    together: bool = False  # several recordings, one after another


@dataclass(frozen=True)
class Bar:
    """A share of one, and what is said of it."""

    name: str
    share: float
    said: str = ""

    @property
    def percent(self) -> str:
        return f"{100.0 * min(max(self.share, 0.0), 1.0):.2f}"


@dataclass(frozen=True)
class Bars(Part):
    """Probabilities one below the other. They are HTML rather than a canvas: their words wrap, and are read aloud."""

    template: ClassVar[str] = "bars.html.j2"
    bars: Sequence[Bar]


@dataclass(frozen=True)
class Interval:
    """A mean with its 90 % interval, by one model, and how that is said."""

    series: str
    low: float
    mean: float
    high: float
    said: str


@dataclass(frozen=True, kw_only=True)
class Range:
    """A parameter within its prior's box: intervals by one model or several, its density, the truth, a remark."""

    name: str
    unit: str
    low: float
    high: float
    intervals: Sequence[Interval]
    density: Float[np.ndarray, " n"] | None = None
    true: float | None = None
    remark: str = ""

    def at(self, value: float) -> str:
        """Percent of the way through the box, for a style sheet."""
        return f"{100.0 * float(np.clip((value - self.low) / (self.high - self.low), 0.0, 1.0)):.2f}"

    def length(self, one: Interval) -> str:
        return f"{float(self.at(one.high)) - float(self.at(one.low)):.2f}"

    @property
    def ends(self) -> tuple[str, str]:
        """Of the box."""
        return minus(f"{self.low:g}"), minus(f"{self.high:g}")

    @property
    def outline(self) -> str:
        """The density over the box as points of a polygon, 100 wide and 30 high."""
        assert self.density is not None
        height = 30.0 * (1.0 - self.density / max(float(self.density.max()), 1e-300))
        across = np.linspace(0.0, 100.0, len(height))
        return " ".join(f"{x:.2f},{y:.2f}" for x, y in zip((0.0, *across, 100.0), (30.0, *height, 30.0), strict=True))


@dataclass(frozen=True)
class Ranges(Part):
    """Parameters one below the other, each in its prior's box."""

    template: ClassVar[str] = "ranges.html.j2"
    rows: Sequence[Range]
    keys: Mapping[str, str]


@dataclass(frozen=True)
class Picture(Part):
    """A static picture at the size it was drawn in, in the page or, if it is large, from its file beside it."""

    template: ClassVar[str] = "picture.html.j2"
    path: Path
    caption: str
    page: Path

    @property
    def width(self) -> int:
        pixels = int.from_bytes(self.path.read_bytes()[16:20], "big")  # of its IHDR chunk, https://www.w3.org/TR/png-3/
        return round(pixels * CSS_PIXELS_PER_INCH / DPI)

    @property
    def source(self) -> str:
        data = self.path.read_bytes()
        if len(data) > PICTURE_BYTES:
            return self.path.relative_to(self.page.parent).as_posix()
        return f"data:image/png;base64,{b64encode(data).decode()}"


@dataclass(frozen=True, kw_only=True)
class Section:
    """A heading, what is to be seen in a sentence or two, and parts."""

    heading: str
    parts: Sequence[Part]
    said: str = ""
