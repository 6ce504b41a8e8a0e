"""report.html: a run on one page, in one file that opens anywhere and needs no network."""

from base64 import b64encode
from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from vehicle_sbi.files import write_text

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
th, td { padding: .35rem .8rem; text-align: right; border-bottom: 1px solid #e3e3e3; white-space: nowrap; }
th { border-bottom: 2px solid #888; font-weight: 600; }
th:first-child, td:first-child { text-align: left; }
figure { margin: 1.2rem 0 2rem; }
figcaption { color: #555; font-size: .9rem; }
img { max-width: 100%; height: auto; }
"""


def write_page(
    path: Path,
    *,
    title: str,
    table_html: str,
    notes: Sequence[str],
    figures: Mapping[str, Path],
    warnings: Sequence[str] = (),
) -> None:
    """Write the page: warnings first, then the table, the notes and the figures (caption to PNG file) in their order.

    `table_html` is taken as it is (`tables.html`); all other text is escaped.
    """
    alarm = "".join(f"<p>{escape(line)}</p>" for line in warnings)
    listed = "".join(f"<li>{escape(line)}</li>\n" for line in notes)
    parts = [
        f"<h1>{escape(title)}</h1>",
        f'<section class="warnings" role="alert">{alarm}</section>' if alarm else "",
        f'<h2>Parameters</h2>\n<div class="table">{table_html}</div>',
        f"<h2>Notes</h2>\n<ul>\n{listed}</ul>" if listed else "",
        "<h2>Figures</h2>" if figures else "",
        *(_figure(caption, file) for caption, file in figures.items()),
    ]
    head = f'<meta charset="utf-8"><meta name="viewport" content="width=device-width"><title>{escape(title)}</title>'
    body = "\n".join(part for part in parts if part)
    head += f"<style>{_CSS}</style>"
    write_text(path, f'<!DOCTYPE html>\n<html lang="en">\n<head>{head}</head>\n<body>\n{body}\n</body>\n</html>\n')


def _figure(caption: str, file: Path) -> str:
    data = b64encode(file.read_bytes()).decode()
    text = escape(caption)
    return f'<figure><img alt="{text}" src="data:image/png;base64,{data}"><figcaption>{text}</figcaption></figure>'
