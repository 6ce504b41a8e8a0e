"""report.html: an answer on one page, in one file that opens anywhere and needs no network.

The headline comes first, then the picture that carries it; tables are folded away below. What draws the pictures is
part of the file: Bokeh's core without its widgets, tables and mathematics, 1.3 MB.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from bokeh.embed import components
from bokeh.resources import Resources
from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup

from vehicle_sbi.files import write_text
from vehicle_sbi.report.page.parts import Curves, Section


@dataclass(frozen=True)
class Drawn:
    """The script that draws a chart, and the element that it is drawn into."""

    script: Markup
    div: Markup


@dataclass(frozen=True, kw_only=True)
class Page:
    """What stands on a page: the headline and the lines after it, warnings, sections that are seen and folded ones."""

    title: str
    headline: str
    lines: Sequence[str] = ()
    warnings: Sequence[str] = ()
    shown: Sequence[Section] = ()
    folded: Sequence[Section] = ()

    @property
    def curves(self) -> Iterator[Curves]:
        """All charts that can be zoomed into."""
        for section in (*self.shown, *self.folded):
            yield from (part for part in section.parts if isinstance(part, Curves))


def write_page(path: Path, page: Page) -> None:
    """Write the page; everything in it is escaped."""
    drawn = {str(curves.figure.id): _drawn(curves) for curves in page.curves}
    engine = "\n".join(Resources(mode="inline", components=["bokeh"], log_level="warn").js_raw) if drawn else ""
    text = templates().get_template("page.html.j2").render(page=page, drawn=drawn, engine=Markup(engine))
    write_text(path, text)


def _drawn(curves: Curves) -> Drawn:
    """A chart as a document of its own, so that one that is folded away costs nothing until it is looked at."""
    script, div = components(curves.figure, wrap_script=False)
    return Drawn(Markup(script), Markup(div))


def templates() -> Environment:
    """The templates of this package, in which everything is escaped."""
    return Environment(
        loader=PackageLoader("vehicle_sbi.report.page", "templates"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
