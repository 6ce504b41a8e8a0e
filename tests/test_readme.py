"""The README's figures of the benchmark are those that stand in its results."""

from itertools import takewhile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
TABLES = ("| metric | all", "| method | all")


def table(lines: list[str], head: str) -> list[str]:
    start = next(i for i, line in enumerate(lines) if line.startswith(head))
    return list(takewhile(lambda line: line.startswith("|"), lines[start:]))


def test_rows_of_the_benchmark_are_those_of_its_page() -> None:
    files = (ROOT / "README.md", ROOT / "benchmarks" / "results" / "concealed.md")
    readme, page = (file.read_text(encoding="utf-8").splitlines() for file in files)
    for head in TABLES:
        rows = table(readme, head)
        assert len(rows) > 3  # a head, a rule and more than one row
        assert [row for row in rows if row not in table(page, head)] == []
