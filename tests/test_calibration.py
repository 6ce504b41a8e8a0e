"""Calibration: exact posteriors are found calibrated, narrowed, widened and shifted ones are not."""

import json
import re
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binom, norm
from script_runs import run_script

from vehicle_sbi.files import sha256
from vehicle_sbi.inference.calibration import (
    CONSISTENT,
    LEVELS,
    NARROW,
    WIDE,
    Calibration,
    by_sbi,
    proportion,
    ranks,
    verdict,
    within,
)
from vehicle_sbi.inference.repetition import Repetition, gathered
from vehicle_sbi.report.calibration import LEGEND, OF_CLASSIFIER, said, table

NAMES = ("l_f", "C_alpha_f")
RECORDINGS, SAMPLES = 400, 999
NOISE = 0.5  # of a recording of theta, whose prior is a standard normal
SURELY = (1e-4, 1.0 - 1e-4)  # quantiles that chance does not pass


def gaussian(*, width: float = 1.0, shift: float = 0.0, n: int = RECORDINGS) -> tuple[np.ndarray, ...]:
    """Truths (n, d), recordings (n, d) and draws (samples, n, d) of their posteriors: with x = theta + noise these are
    normal about x / (1 + noise^2) with variance noise^2 / (1 + noise^2), here of another width
    and shifted, in units of that deviation."""
    rng = np.random.default_rng(0)
    theta = rng.standard_normal((n, len(NAMES)))
    x = theta + NOISE * rng.standard_normal(theta.shape)
    std = NOISE / np.sqrt(1.0 + NOISE**2)
    draws = x / (1.0 + NOISE**2) + std * (shift + width * rng.standard_normal((SAMPLES, *theta.shape)))
    return theta, x, draws


def calibration(*, width: float = 1.0, shift: float = 0.0) -> Calibration:
    theta, _, draws = gaussian(width=width, shift=shift)
    each = [ranks(one, draws[:, i]) for i, one in enumerate(theta)]
    return Calibration(names=NAMES, ranks=np.array(each), samples=SAMPLES)


def sbi_tested(n: int, *, shift: float = 0.0) -> Calibration:
    """sbi's tests of the same posteriors, L-C2ST at the first of the recordings."""
    theta, x, draws = (torch.as_tensor(one, dtype=torch.float32) for one in gaussian(n=n, shift=shift))
    torch.manual_seed(0)
    return by_sbi(NAMES, theta, x, draws, local=(x[:1], draws[:, 0]), seed=0, trials=20)


def test_an_exact_posterior_is_calibrated() -> None:
    """Counts of held truths are binomial with the interval's level; ranks are uniform."""
    found = calibration()
    for level in LEVELS:
        low, high = binom.ppf(SURELY, RECORDINGS, level)
        assert ((low <= found.held(level)) & (found.held(level) <= high)).all()
    assert found.uniform.all()
    assert found.verdicts == (CONSISTENT,) * len(NAMES)


@pytest.mark.parametrize(("width", "told"), [(0.5, NARROW), (2.0, WIDE)])
def test_a_posterior_of_another_width_holds_what_a_normal_of_that_width_holds(width: float, told: str) -> None:
    found = calibration(width=width)
    for level in LEVELS:
        share = 2.0 * norm.cdf(width * norm.ppf(0.5 + level / 2)) - 1.0
        low, high = binom.ppf(SURELY, RECORDINGS, share)
        assert ((low <= found.held(level)) & (found.held(level) <= high)).all()
    assert found.verdicts == (told,) * len(NAMES)


@pytest.mark.parametrize("shift", [-0.5, 0.5])
def test_a_shifted_posterior_fails_the_rank_test(shift: float) -> None:
    """Half a standard deviation moves the ranks' distribution by 2 Phi(1/4) - 1 = 0.197, of which chance has 0.1 with
    a probability below 0.001."""
    found = calibration(shift=shift)
    assert (found.ks_p < 1e-3).all()
    assert not found.uniform.any()
    assert all("ranks are not uniform" in line for line in said(table(found)))


@given(samples=st.integers(1, 3000), level=st.floats(0.01, 0.99))
def test_an_interval_holds_its_level_of_equally_likely_ranks(samples: int, level: float) -> None:
    every = np.arange(samples + 1)[:, None]
    assert abs(within(every, samples, level).sum() - level * (samples + 1)) <= 1.0 + 1e-9


def test_a_truth_is_held_where_the_quantiles_of_the_draws_hold_it() -> None:
    theta, _, draws = gaussian()
    found = calibration()
    for level in LEVELS:
        low, high = np.quantile(draws, (0.5 - level / 2, 0.5 + level / 2), axis=0)
        differ = ((low <= theta) & (theta <= high)) != within(found.ranks, SAMPLES, level)
        edges = [(SAMPLES + 1) * (0.5 + side * level / 2) for side in (-1, 1)]
        assert all(min(abs(rank - edge) for edge in edges) <= 1.5 for rank in found.ranks[differ])


@given(held=st.integers(0, 50), more=st.integers(0, 50))
def test_the_interval_of_a_share_is_wilsons(held: int, more: int) -> None:
    n, z = held + more + 1, norm.ppf(0.975)
    share = held / n
    middle, half = share + z**2 / (2 * n), z * np.sqrt(share * (1 - share) / n + z**2 / (4 * n**2))
    expected = np.array([middle - half, middle + half]) / (1 + z**2 / n)
    np.testing.assert_allclose(proportion(held, n), np.clip(expected, 0.0, 1.0), atol=1e-12)


def test_the_verdict_is_whether_the_interval_contains_the_level() -> None:
    assert [verdict(0.7, 0.8), verdict(0.85, 0.95), verdict(0.92, 0.99)] == [NARROW, CONSISTENT, WIDE]


def test_sbi_finds_an_exact_posterior_calibrated_and_ranks_it_as_we_do() -> None:
    found = sbi_tested(60)
    theta, _, draws = gaussian(n=60)
    assert (np.abs(found.ranks - [ranks(one, draws[:, i]) for i, one in enumerate(theta)]) <= 1).all()  # float32
    assert found.joint is not None
    assert found.joint.tarp_p > 0.05
    assert found.joint.local_p > 0.01
    from sbi.diagnostics.sbc import check_uniformity_frequentist

    theirs = check_uniformity_frequentist(torch.as_tensor(found.ranks), SAMPLES)
    np.testing.assert_allclose(found.ks_p, theirs, rtol=1e-5)
    assert found.c2st_ranks is not None
    assert (found.c2st_ranks < 0.65).all()


def test_sbi_finds_a_shifted_posterior_out() -> None:
    """Three standard deviations leave hardly any overlap, for a classifier too."""
    found = sbi_tested(60, shift=3.0)
    assert found.joint is not None
    assert found.joint.local_p < 0.05
    assert abs(found.joint.area) > 0.02
    assert not found.uniform.any()


def repetition(failed: str | None = None) -> Repetition:
    return Repetition(
        seed=1,
        truth=[1.0, 1.0],
        rank=[] if failed else [3, 4],
        mean=[],
        std=[],
        reweighted=None,
        failed=failed,
        seconds=1.0,
    )


def test_a_study_without_a_posterior_does_not_count_and_is_told() -> None:
    found = gathered(NAMES, [repetition(), repetition("it contradicts itself"), repetition()], 10)
    assert len(found.ranks) == 2
    assert "1 of 3 studies have no posterior and do not count: it contradicts itself" in found.notes
    with pytest.raises(ValueError, match="every repetition fails, the first by: it contradicts itself"):
        gathered(NAMES, [repetition("it contradicts itself")], 10)


def test_sentences_of_the_legend_are_short() -> None:
    assert max(len(sentence.split()) for sentence in (*LEGEND, OF_CLASSIFIER)) <= 25


# The script.

TINY = [
    "features=handcrafted", "estimator=mdn", "rounds.simulations=100", "training.max_epochs=5", "manoeuvre.rate=50",
    "samples=100",
]  # fmt: skip
WHOLE = [*TINY, "experiment=smoke", "rounds.rounds=1", "repetitions=4"]


def run(*arguments: str) -> tuple[int, str, str]:
    return run_script("calibrate", *arguments)


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A finished calibration of a tiny study, and what it printed."""
    folder = tmp_path_factory.mktemp("calibration") / "run"
    status, out, err = run(*WHOLE, f"hydra.run.dir={folder}")
    assert status == 0, err
    return folder, out


def test_a_calibration_leaves_what_it_promises(whole: tuple[Path, str]) -> None:
    folder, out = whole
    rows = pd.read_csv(folder / "calibration.csv")
    assert list(rows["n"]) == [4] * len(rows)
    for level in ("50", "80", "90"):
        assert (rows[f"low{level}"] <= rows[f"hold{level}"]).all()
        assert (rows[f"hold{level}"] <= rows[f"high{level}"]).all()
    assert rows["ks_p"].between(0.0, 1.0).all()
    for name, told in rows[["name", "verdict"]].to_numpy():
        assert f"{name}: {told}" in out
        assert f"- {name}: {told}" in (folder / "calibration.md").read_text()
    assert (folder / "calibration.png").read_bytes().startswith(b"\x89PNG")
    assert sorted(path.name for path in (folder / "recordings").iterdir()) == [f"{i:04d}.json" for i in range(4)]


def test_each_repetition_has_its_own_seed_and_truth_and_its_ranks_are_counted(whole: tuple[Path, str]) -> None:
    done = [json.loads(path.read_text()) for path in sorted((whole[0] / "recordings").iterdir())]
    assert len({one["seed"] for one in done}) == len({tuple(one["truth"]) for one in done}) == 4
    found = Calibration(names=("",) * 6, ranks=np.array([one["rank"] for one in done]), samples=100)
    rows = pd.read_csv(whole[0] / "calibration.csv")
    np.testing.assert_allclose(rows["hold90"], found.held(0.9) / 4)


def test_a_lost_repetition_is_made_again_and_no_other(whole: tuple[Path, str]) -> None:
    folder, out = whole
    files = sorted((folder / "recordings").iterdir())
    before = {path: (path.stat().st_mtime_ns, sha256(path)) for path in files}
    lost = json.loads(files[1].read_text())
    files[1].unlink()
    status, again, err = run(*WHOLE, f"hydra.run.dir={folder}")
    assert status == 0, err
    assert "recordings/0001.json is damaged or missing" in err
    made = json.loads(files[1].read_text())
    assert {**made, "seconds": 0} == {**lost, "seconds": 0}
    untouched = [path for path in files if (path.stat().st_mtime_ns, sha256(path)) == before[path]]
    assert untouched == [files[0], *files[2:]]
    assert re.sub(r"Seconds.*", "", again) == re.sub(r"Seconds.*", "", out)


@pytest.mark.parametrize(
    ("given", "line"),
    [
        (["recording=drive.csv"], "recording: a recording has no truth to repeat"),
        pytest.param(["recording=demo"], "recording: a recording has no truth to repeat", marks=pytest.mark.slow),
        pytest.param(["workers=0"], "workers = 0; it must be at least 1", marks=pytest.mark.slow),
        pytest.param(["truth={l_f: 1.2}"], "truth: each repetition draws its own", marks=pytest.mark.slow),
        pytest.param(["rounds=amortised", "repetitions=5"], "repetitions = 5; the tests", marks=pytest.mark.slow),
    ],
)
def test_what_cannot_be_calibrated_is_refused_in_one_line(tmp_path: Path, given: list[str], line: str) -> None:
    status, out, err = run(*given, f"hydra.run.dir={tmp_path / 'run'}")
    assert (status, out, err.count("\n")) == (2, "", 1), err
    assert line in err
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_two_processes_make_the_same_repetitions_as_one(whole: tuple[Path, str], tmp_path: Path) -> None:
    status, _, err = run(*WHOLE, "workers=2", f"hydra.run.dir={tmp_path / 'run'}")
    assert status == 0, err
    for path in (whole[0] / "recordings").iterdir():
        made = json.loads((tmp_path / "run" / "recordings" / path.name).read_text())
        assert {**made, "seconds": 0} == {**json.loads(path.read_text()), "seconds": 0}


@pytest.mark.slow
def test_an_amortised_network_is_trained_once_and_tested_by_sbi(tmp_path: Path) -> None:
    tiny = [*TINY, "rounds=amortised", "repetitions=25"]
    status, out, err = run(*tiny, f"hydra.run.dir={tmp_path / 'run'}")
    assert status == 0, err
    assert "TARP" in out
    assert "L-C2ST" in out
    rows = pd.read_csv(tmp_path / "run" / "calibration.csv")
    assert rows["c2st_ranks"].between(0.0, 1.0).all()
    assert [path.name for path in (tmp_path / "run" / "rounds").iterdir()] == ["round_0.pt"]
    trained = (tmp_path / "run" / "rounds" / "round_0.pt").stat().st_mtime_ns
    (tmp_path / "run" / "calibration.csv").unlink()
    status, again, err = run(*tiny, f"hydra.run.dir={tmp_path / 'run'}")
    assert status == 0, err
    assert again == out
    assert (tmp_path / "run" / "rounds" / "round_0.pt").stat().st_mtime_ns == trained
