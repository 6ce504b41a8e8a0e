"""report.html: a run on one page, in one file that opens anywhere and needs no network."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from vehicle_sbi.files import write_text
from vehicle_sbi.report.figures import DPI

CSS_PIXELS_PER_INCH = 96

_CSS = """
:root { color-scheme: light; }
body { max-width: 72rem; margin: 2rem auto; padding: 0 1.2rem; color: #222; background: #fff;
       font: 16px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: 0 0 1rem; }
h2 { font-size: 1.15rem; margin: 2.2rem 0 .6rem; }
.warnings { border-left: 4px solid #c8322b; background: #fbeeed; padding: .6rem 1rem; margin: 1rem 0; }
.warnings p { margin: .2rem 0; }
.table { overflow-x: auto; }
table { border-collapse: collapse; font-size: .9rem; font-variant-numeric: tabular-nums; }
th, td { padding: .35rem .8rem; text-align: left; vertical-align: top; border-bottom: 1px solid #e3e3e3;
         white-space: nowrap; }
td:last-child { white-space: normal; }
.number { text-align: right; }
th { border-bottom: 2px solid #888; font-weight: 600; }
th:first-child, td:first-child { padding-left: 0; }
th:last-child, td:last-child { padding-right: 0; }
sup { font-size: .75em; line-height: 0; }
figure { margin: 1.2rem 0 2rem; }
figcaption, .legend { color: #555; font-size: .9rem; }
img { max-width: 100%; height: auto; }
@media print { figure { break-inside: avoid; } h2 { break-after: avoid; } }
"""


def write_page(
    path: Path,
    *,
    title: str,
    sections: Mapping[str, str],
    notes: Sequence[str],
    figures: Mapping[str, Path],
    warnings: Sequence[str] = (),
) -> None:
    """Write the page: warnings first, then sections, the notes and the figures (caption to PNG file) in their order.

    What is in a section (heading to HTML, as `tables.html` makes it) is taken as it is; all other text is escaped.
    """
    alarm = "".join(f"<p>{escape(line)}</p>" for line in warnings)
    listed = "".join(f"<li>{escape(line)}</li>\n" for line in notes)
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<section class="warnings" role="alert">{alarm}</section>' if alarm else "",
        *(f"<h2>{escape(heading)}</h2>\n{content}" for heading, content in sections.items()),
        f"<h2>Notes</h2>\n<ul>\n{listed}</ul>" if listed else "",
        "<h2>Figures</h2>" if figures else "",
        *(_figure(caption, file) for caption, file in figures.items()),
    ]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    body = "\n".join(part for part in parts if part)
    head += f"<style>{_CSS}</style>"
    write_text(path, f'<!DOCTYPE html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{body}\n</body>\n</html>\n')


def in_section(table: str, legend: str = "") -> str:
    """A table's HTML that scrolls where it is wider than the page, with what explains it below."""
    below = f'\n<p class="legend">{escape(legend)}</p>' if legend else ""
    return f'<div class="table">{table}</div>{below}'


def _figure(caption: str, file: Path) -> str:
    """The picture at the size it was drawn in, so that the letters of all pictures are of one size."""
    data, text = file.read_bytes(), escape(caption)
    pixels = int.from_bytes(data[16:20], "big")  # of its IHDR chunk: https://www.w3.org/TR/png-3/#11IHDR
    source = f"data:image/png;base64,{b64encode(data).decode()}"
    width = round(pixels * CSS_PIXELS_PER_INCH / DPI)
    return f'<figure><img alt="{text}" width="{width}" src="{source}"><figcaption>{text}</figcaption></figure>'
