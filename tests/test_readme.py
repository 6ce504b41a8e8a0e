"""Figures of the benchmarks in README and docs are those that stand in their results."""

import re
from itertools import takewhile
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
SHORT = (
    "index tutorial_demo tutorial_own_csv diagnosis benchmark trust inspect formats export how_it_works scaling "
    "plausible add_an_effect words"
).split()
TABLES = ("| metric | all", "| method | all")


def table(lines: list[str], head: str) -> list[str]:
    start = next(i for i, line in enumerate(lines) if line.startswith(head))
    return list(takewhile(lambda line: line.startswith("|"), lines[start:]))


def test_rows_of_the_benchmark_are_those_of_its_page() -> None:
    files = (ROOT / "docs" / "accuracy.md", ROOT / "benchmarks" / "results" / "concealed.md")
    readme, page = (file.read_text(encoding="utf-8").splitlines() for file in files)
    for head in TABLES:
        rows = table(readme, head)
        assert len(rows) > 3  # a head, a rule and more than one row
        assert [row for row in rows if row not in table(page, head)] == []


def test_the_readme_is_short_and_its_six_numbers_are_those_of_the_whole_cars() -> None:
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    page = (ROOT / "benchmarks" / "results" / "whole_car_209.md").read_text(encoding="utf-8")
    measured = {
        row.split("|")[1].strip(): row.split("|")[2].split()[0] for row in page.splitlines() if row.count("|") > 4
    }
    wrong, named = measured["names above 0.5 that are not there, a case"], measured["names above 0.5, a case"]
    error, held = "base parameters: relative error, median, ", "their 90 % intervals hold the truth, "
    assert len(readme.split()) < 800
    for row in (
        f"before, after | {measured[error + 'base model']}, {measured[error + 'after diagnosis']} |",
        f"before, after | {measured[held + 'base model']}, {measured[held + 'after diagnosis']} |",
        f"are named | {measured['effects with SNR 8 beyond all others: inclusion above 0.5']} |",
        f"probabilities | {measured['calibration error of inclusion probabilities above 0']} |",
        f"not there, a car | {wrong} of {named} |",
        f"a diagnosis, median | {float(measured['seconds a diagnosis, median']):.0f}, beside",
    ):
        assert row in readme


def sentences(page: str) -> list[str]:
    """Of the paragraphs of a page, without tables, headings and code; a name in backticks is one word."""
    told = re.sub(r"`[^`]*`", "name", re.sub(r"```.*?```", "", page, flags=re.DOTALL))
    lines = [line for line in told.splitlines() if not line.lstrip().startswith(("|", "#", "!"))]
    told = re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", "\n".join(lines))
    return [
        one for part in re.split(r"\n\s*\n|\n- ", told) for one in re.split(r"(?<=[.!?:])\s+", " ".join(part.split()))
    ]


@pytest.mark.parametrize("name", ["README.md", *(f"docs/{page}.md" for page in SHORT)])
def test_no_sentence_has_more_than_25_words(name: str) -> None:
    assert [one for one in sentences((ROOT / name).read_text(encoding="utf-8")) if len(one.split()) > 25] == []


def test_every_link_of_the_docs_leads_to_a_file() -> None:
    for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")):
        links = re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8"))
        missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
        assert not missing, f"{page.name}: {missing}"
