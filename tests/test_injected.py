"""Effects injected into real recordings: both halves of a pair are the same drive, and the difference is scored."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from injected import cases, page
from injected.scores import combined, difference

HERE = cases.available(cases.ALL_SOURCES)
needs_recordings = pytest.mark.skipif(not HERE, reason="no real recordings in VEHICLE_SBI_RECORDINGS")


@needs_recordings
def test_a_pair_is_the_same_drive_but_for_what_is_injected(tmp_path: Path) -> None:
    cases.build(0, 1, tmp_path)
    case, sealed = tmp_path / "cases" / "0001", tmp_path / "sealed" / "0001.json"
    truth = json.loads(sealed.read_text())
    for name in ("a.csv", "heldout_0.csv"):
        without, with_it = (pd.read_csv(case / half / name) for half in cases.HALVES)
        assert list(without) == list(with_it)
        moved = [c for c in without if not np.array_equal(without[c], with_it[c], equal_nan=True)]
        acts = "steering" if truth["effect"].startswith("steering") else ("a_", "yaw_rate")
        assert moved
        assert all(str(column).startswith(acts) for column in moved)
    contents = [yaml.safe_load((case / half / "case.yaml").read_text()) for half in cases.HALVES]
    assert contents[0]["prior"] == contents[1]["prior"]
    assert truth["effect"] not in {name.split(".")[0] for name in contents[0]["prior"]}
    assert truth["snr"] > 1.0
    before = (case / "with" / "a.csv").read_bytes()
    cases.build(0, 1, tmp_path / "again")
    assert (tmp_path / "again" / "cases" / "0001" / "with" / "a.csv").read_bytes() == before


def verdict(effects: Mapping[str, float], size: tuple[float, float] | None, l_f: float) -> dict[str, Any]:
    own = {"mean": size[0], "std": size[1]} if size else {}
    return {
        "effects": effects,
        "explanations": [{"effects": ["gyro_scale"], "parameters": {"gyro_scale.z": own}}] if size else [],
        "base_parameters": {"l_f": {"before": {"mean": l_f, "std": 0.03}, "after": {"mean": 1.3, "std": 0.04}}},
    }


def written(folder: Path, index: int, without: Mapping[str, Any], with_it: Mapping[str, Any]) -> None:
    truth = {"index": index, "source": "a", "effect": "gyro_scale", "parameters": {"z": 1.1}, "snr": 8.0}
    (folder / "sealed").mkdir(exist_ok=True)
    (folder / "sealed" / f"{index:04d}.json").write_text(json.dumps(truth | {"alike": ["body_roll"]}))
    for half, answer in zip(cases.HALVES, (without, with_it), strict=True):
        run = folder / "cases" / f"{index:04d}" / half / "tool"
        run.mkdir(parents=True)
        (run / "verdict.json").write_text(json.dumps(answer))


def test_what_comes_with_an_effect_is_scored_and_what_was_there_is_not(tmp_path: Path) -> None:
    without = verdict({"sensor_delay": 0.9, "gust": 0.6}, None, 1.27)
    written(tmp_path, 0, without, verdict({"sensor_delay": 0.8, "gyro_scale": 0.7, "payload": 0.6}, (1.11, 0.01), 1.3))
    found = difference(tmp_path, 0, "tool")
    assert found is not None
    assert (found.new, found.gone, found.names) == (("payload",), ("gust",), 2)
    assert (found.before, found.after, found.found) == (0.0, 0.7, True)
    assert found.sizes.tolist() == [1.0]  # 1.11 is within 1.645 times 0.01 of 1.1
    assert found.moved.tolist() == [0.0]
    assert found.moved_base == pytest.approx([0.03 / (0.03 * np.sqrt(2.0))])
    assert difference(tmp_path, 1, "tool") is None
    assert "| 1.00 (1.00 to 1.00; 1) |" in page.report({"tool": [found]}, {"tool": []}, "prove", "here")


def test_what_cannot_be_told_from_it_counts_and_sizes_add_to_the_car_s_own(tmp_path: Path) -> None:
    own = verdict({"gyro_scale": 0.9}, (1.05, 0.01), 1.3)
    written(tmp_path, 0, own, verdict({"body_roll": 0.9, "gyro_scale": 0.6}, (1.155, 0.01), 1.3))
    found = difference(tmp_path, 0, "tool")
    assert found is not None
    assert (found.new, found.after) == ((), 0.9)
    assert found.sizes.tolist() == [1.0]  # 1.05 times 1.1
    assert combined("sensor_delay.imu", 0.03, 0.04) == pytest.approx(0.07)
