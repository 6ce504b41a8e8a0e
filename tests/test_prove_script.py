"""prove.py as users run it: cases built, diagnosed in processes of their own and scored; continued, not begun again."""

from pathlib import Path

import pandas as pd
import pytest
from script_runs import run_script


def prove(*arguments: str) -> tuple[int, str, str]:
    return run_script("prove", *arguments)


@pytest.mark.parametrize(
    ("argument", "said"),
    [
        ("cases=0", "cases = 0; it must be a whole number above 0"),
        ("first=400", "first = 400; it must be a case before cases = 400, counted from 0"),
        ("mix=some", "prove: unknown mix 'some'; known: "),
    ],
)
def test_a_wrong_value_gets_one_line(tmp_path: Path, argument: str, said: str) -> None:
    status, out, err = prove(argument, f"folder={tmp_path}/cases", f"results={tmp_path}/results")
    assert (status, out) == (2, "")
    assert err.startswith(f"error: {said}")
    assert err.count("\n") == 1
    assert not (tmp_path / "results").exists()


def test_a_case_is_built_diagnosed_and_scored_and_nothing_is_done_twice(tmp_path: Path) -> None:
    where = [f"folder={tmp_path}/proof", f"results={tmp_path}/results", "workers=1", "baselines=false"]
    given = ["cases=1", "seed=8", "mix=nothing", *where]  # seconds of two channels
    status, page, err = prove(*given)
    assert status == 0, err
    assert "`python scripts/prove.py cases=1 seed=8 mix=nothing`\n\n1 cases, 1 of them diagnosed, 0 without" in page
    assert (tmp_path / "results" / "nothing.md").read_text() == page.removesuffix("\n")
    assert len((tmp_path / "results" / "nothing.csv").read_text().splitlines()) == 2
    case = tmp_path / "proof" / "cases" / "0000"
    assert "sealed" not in (case / "case.yaml").read_text()  # of where the truth is, the diagnosis is told nothing
    kept = [case / "a.csv", case / "diagnosis" / "verdict.json", tmp_path / "proof" / "sealed" / "0000.json"]
    before = [file.stat().st_mtime_ns for file in kept]
    status, again, err = prove(*given)
    assert (status, again) == (0, page), err
    assert [file.stat().st_mtime_ns for file in kept] == before
    status, _, err = prove("cases=1", "seed=2", "mix=nothing", *where)
    assert status == 2
    assert "holds cases of seed 8, mix nothing, not of seed 2, mix nothing; name another folder" in err


@pytest.mark.slow
def test_a_cluster_finds_what_one_process_finds(tmp_path: Path) -> None:
    tables = []
    for name, words in (("local", ["engine=local", "workers=1"]), ("dask", ["engine=dask", "workers=2"])):
        where = [f"folder={tmp_path}/{name}", f"results={tmp_path}/results_{name}", "baselines=false", *words]
        status, _, err = prove("cases=2", "seed=8", "mix=nothing", *where)
        assert status == 0, err
        tables.append(pd.read_csv(tmp_path / f"results_{name}" / "nothing.csv").drop(columns="seconds"))
    pd.testing.assert_frame_equal(*tables, check_exact=True)
    assert len(tables[0]) == 2
