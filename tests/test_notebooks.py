"""Notebooks of the docs: committed as they ran, small, and they run anew."""

from pathlib import Path
from typing import Any

import nbformat
import pytest
from conftest import ROOT
from nbclient import NotebookClient

NOTEBOOKS = sorted((ROOT / "docs" / "notebooks").glob("*.ipynb"))
SMALL = 300_000  # bytes of a notebook


def opened(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def kinds(notebook: Any) -> list[list[list[str]]]:
    """What each code cell puts out: the kinds of text and pictures, output by output."""
    cells = [cell for cell in notebook.cells if cell.cell_type == "code"]
    return [[sorted(output.get("data", [output.output_type])) for output in cell.outputs] for cell in cells]


def test_there_are_notebooks() -> None:
    assert {path.stem for path in NOTEBOOKS} >= {"identify", "diagnose"}


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_committed_as_it_ran_from_top_to_bottom(path: Path) -> None:
    notebook = opened(path)
    nbformat.validate(notebook)
    ran = [cell for cell in notebook.cells if cell.cell_type == "code"]
    assert [cell.execution_count for cell in ran] == [*range(1, len(ran) + 1)]
    streams = {output.get("name") for cell in ran for output in cell.outputs}
    assert not streams & {"stderr"}, "warnings belong out of what readers see"
    assert not [output for cell in ran for output in cell.outputs if output.output_type == "error"]
    assert any("image/png" in one for cell in kinds(notebook) for one in cell)


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_small_and_names_no_place_of_this_machine(path: Path) -> None:
    content = path.read_bytes()
    assert len(content) < SMALL
    assert str(ROOT).encode() not in content
    assert b"/tmp/" not in content


@pytest.mark.slow
@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_runs_anew_and_puts_out_what_it_did(path: Path) -> None:
    committed, anew = opened(path), opened(path)
    for cell in anew.cells:
        if cell.cell_type == "code":
            cell.outputs, cell.execution_count = [], None
    place = {"metadata": {"path": str(path.parent)}}
    NotebookClient(anew, timeout=280, kernel_name="python3", resources=place).execute()
    assert kinds(anew) == kinds(committed)
