"""The README's figures of the benchmark are those that stand in its results."""

from pathlib import Path

from concealed.summary import METHODS, METRICS

ROOT = Path(__file__).resolve().parent.parent


def test_rows_of_the_benchmark_are_those_of_its_page() -> None:
    page = (ROOT / "benchmarks" / "results" / "concealed.md").read_text(encoding="utf-8").splitlines()
    labels = {f"| {label} |" for label in (*(metric.label for metric in METRICS), *METHODS)}
    readme = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    rows = [line for line in readme if any(line.startswith(label) for label in labels)]
    assert len(rows) > len(METHODS)
    assert [row for row in rows if row not in page] == []
