"""The site of the docs: `make docs` writes it to build/docs. Links that leave docs/ become files to download."""

import re
from importlib.metadata import version as installed
from pathlib import Path

from sphinx.application import Sphinx

project = "vehicle_sbi"
author = "The vehicle_sbi developers"
project_copyright = author
version = release = installed("vehicle_sbi")

extensions = ["myst_nb", "sphinx.ext.autodoc"]
nb_execution_mode = "off"  # notebooks are shown as they were saved
myst_heading_anchors = 3

html_theme = "furo"
html_title = "vehicle_sbi"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False

autodoc_member_order = "bysource"
autodoc_typehints = "description"
default_role = "code"  # docstrings write `name`

DOCS = Path(__file__).resolve().parent
MARKDOWN_LINK = re.compile(r"\]\(([^()\s#:]+\.md)\)")


def outside_as_files(app: Sphinx, docname: str, source: list[str]) -> None:
    """Mark links to Markdown outside of docs/ as files: it is no page of the site."""
    folder = (DOCS / docname).parent

    def marked(link: re.Match[str]) -> str:
        inside = (folder / link[1]).resolve().is_relative_to(DOCS)
        return link[0] if inside else f"](path:{link[1]})"

    source[0] = MARKDOWN_LINK.sub(marked, source[0])


def setup(app: Sphinx) -> None:
    app.connect("source-read", outside_as_files)
