"""Recordings that are diagnosed together are one after another; what does not go together is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from cars import PAPER
from recorded import lateral, recorded

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.noise import ConstantNoise, EstimatedNoise
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.directions import longest
from vehicle_sbi.mismatch.hypotheses.block import lies_in, own_time, stretches
from vehicle_sbi.mismatch.hypotheses.hypothesis import Block
from vehicle_sbi.mismatch.problem.case import Diagnosis, _shares
from vehicle_sbi.physics.single_track import INPUTS

PRIOR = {"l_f": [1.0, 1.5], "delta_C_alpha_f": [-0.3, 0.3], "delta_C_alpha_r": [-0.3, 0.3]}


# The mapping of a native file, as a user writes it down.
NATIVE = "".join(
    f"{name}: {{column: {CHANNELS[name].column}}}\n" for name in ("steering", "v_x", "a_x", "a_y", "yaw_rate")
)


def written(path: Path, seed: int, **effects: float) -> Path:
    """A native file of the shared drive, with effects if there are any."""
    sim = lateral()
    observation = recorded(sim, seed=seed, **effects)
    u = sim.windows.u[0]
    columns = {"time_s": u[:, INPUTS.index("time")], "steering_rad": u[:, INPUTS.index("steering")]}
    columns["v_x_mps"] = u[:, INPUTS.index("v_x")]
    columns |= {CHANNELS[c].column: y for c, y in zip(sim.windows.channels, observation.observed, strict=True)}
    pd.DataFrame(columns).to_csv(path, index=False)
    return path


def diagnosis(files: list[Path], heldout: list[Path] | None = None, **changes: Any) -> Diagnosis:
    settings: dict[str, Any] = {
        "vehicle": PAPER, "model": "single_track", "drive": "speed", "prior": PRIOR, "effects": [], "window_s": 10.0,
        "warmup_s": 0.5, "noise": EstimatedNoise(), "seed": 0, "recordings": [str(f) for f in files],
        "recording": RecordingFile(path=str(files[0]), channels=("a_x", "a_y", "yaw_rate")),
        "heldout": [str(f) for f in heldout or []],
    }  # fmt: skip
    settings |= changes
    return Diagnosis(**settings)


def test_recordings_run_on_one_clock(tmp_path: Path) -> None:
    case = diagnosis([written(tmp_path / "a.csv", 0), written(tmp_path / "b.csv", 1)], [written(tmp_path / "c.csv", 2)])
    windows = case.prepare().observation.simulator.windows
    clock = windows.u[..., INPUTS.index("time")].reshape(-1)
    assert windows.u.shape[0] == 2
    np.testing.assert_allclose(np.diff(clock), 0.02, atol=1e-9)


@pytest.mark.parametrize("held", [0, 45])
def test_of_many_recordings_whole_ones_are_held_out_and_no_more_are_used_than_windows(
    tmp_path: Path, held: int
) -> None:
    files = [written(tmp_path / f"{k}.csv", k) for k in range(60 + held)]
    case = diagnosis(files[:60], files[60:]).prepare()
    fitted, kept = ({*part.simulator.windows.recordings} for part in (case.observation, case.held_out))
    assert case.apart
    assert fitted.isdisjoint(case.held_out_names)
    assert kept <= {*case.held_out_names}
    assert (len(fitted), len(case.held_out_names)) == ((40, 40) if held else (40, 15))
    assert len(case.observation.simulator.windows.t) <= 80
    assert (
        "40 of 60 recordings are fitted: where" in " ".join(case.notes)
        if held
        else "every fourth of 60" in case.notes[0]
    )


def test_a_channel_that_is_wrong_is_told_from_what_is_worth_a_warning_alone(tmp_path: Path) -> None:
    flipped, coarse = (written(tmp_path / f"{name}.csv", seed) for seed, name in enumerate(("flipped", "coarse")))
    column = CHANNELS["a_y"].column
    for path, change in ((flipped, lambda a_y: -a_y), (coarse, lambda a_y: np.round(a_y))):
        table = pd.read_csv(path)
        table.assign(**{column: change(table[column])}).to_csv(path, index=False)
    case = diagnosis([flipped, coarse], [written(tmp_path / "held.csv", 2)]).prepare()
    (wrong,) = case.wrong
    assert wrong.startswith("flipped: ")
    assert "is a_y flipped?" in wrong or "is a_y or yaw_rate flipped?" in wrong
    assert wrong in case.warnings
    assert [line for line in case.warnings if line.startswith("coarse: ")]


def test_without_held_out_recordings_blocks_of_time_are_held_out(tmp_path: Path) -> None:
    case = diagnosis([written(tmp_path / "a.csv", 0)], window_s=2.0).prepare()
    fitted, held = (o.simulator.windows for o in (case.observation, case.held_out))
    assert not case.apart
    assert case.held_out_names == ("blocks of a",)
    times = [w.t.reshape(-1)[w.valid.any(axis=0)] for w in (fitted, held)]
    # The buffer of holdout() lies between them, less half a sample.
    assert np.abs(np.subtract.outer(*times)).min() > 1.0 - 0.01


def test_a_recording_is_not_both_fitted_and_held_out(tmp_path: Path) -> None:
    a = written(tmp_path / "a.csv", 0)
    with pytest.raises(InputError, match="is also fitted"):
        diagnosis([a], [a]).prepare()


def test_a_box_that_excludes_the_null_is_refused_where_existence_is_asked(tmp_path: Path) -> None:
    prior = PRIOR | {"steering_ratio": {"gain": [1.1, 1.3]}}
    with pytest.raises(InputError, match=r"steering_ratio.gain = \[1.1, 1.3\] excludes 1, where the effect vanishes"):
        diagnosis([written(tmp_path / "a.csv", 0)], prior=prior).prepare()


def test_half_of_what_is_held_out_helps_to_name_and_the_other_half_proves(tmp_path: Path) -> None:
    fitted, held = written(tmp_path / "a.csv", 0), written(tmp_path / "b.csv", 1)
    case = diagnosis([fitted], [held]).prepare()
    assert case.apart
    assert case.naming is not None
    naming, proving = (one.simulator.windows.valid for one in (case.naming, case.held_out))
    assert not (naming & proving).any()
    assert naming.any(axis=1).all()
    assert proving.any(axis=1).all()
    assert diagnosis([fitted], window_s=2.0).prepare().naming is None  # blocks of the same drive tell nothing new


def test_a_place_on_that_clock_is_said_in_each_recordings_own_time(tmp_path: Path) -> None:
    # The clock begins at the first sample that is used, about 2 s into the first recording (the speed that is looked at
    # is smoothed), and runs on into the second one.
    late = pd.read_csv(written(tmp_path / "late.csv", 0))
    late.loc[late["time_s"] < 2.0, "v_x_mps"] = 0.1
    late.to_csv(tmp_path / "late.csv", index=False)
    case = diagnosis([tmp_path / "late.csv", written(tmp_path / "b.csv", 1)], [written(tmp_path / "c.csv", 2)])
    simulator = case.prepare().observation.simulator
    ends = [float(pd.read_csv(tmp_path / name)["time_s"].iloc[-1]) for name in ("late.csv", "b.csv")]
    begun, half = float(simulator.windows.t[0, 0]), 0.5 / simulator.windows.rate + 1e-9
    assert begun == pytest.approx(2.0, abs=0.2)
    first, second = own_time(simulator, 3.0, 1e3)
    assert (first.recording, second.recording) == ("late", "b")
    assert first.from_s == pytest.approx(begun + 3.0, abs=2.0 * half)
    assert second.from_s == pytest.approx(0.0, abs=half)
    assert [first.to_s, second.to_s] == pytest.approx(ends, abs=half)
    (whole,) = own_time(simulator, first.to_s - begun + 2.5, first.to_s - begun + 3.5)
    assert whole.recording == "b"
    assert [whole.from_s, whole.to_s] == pytest.approx([2.5, 3.5], abs=4.0 * half)


def test_what_happens_at_a_moment_does_so_in_the_blocks_that_are_held_out_of_the_same_drive(tmp_path: Path) -> None:
    # The clock of fitted and of held-out samples is the time of the file less that of the first sample that is used,
    # and a profile is spread over as long a time in both.
    late = pd.read_csv(written(tmp_path / "late.csv", 0))
    late.loc[late["time_s"] < 2.0, "v_x_mps"] = 0.1
    late.to_csv(tmp_path / "late.csv", index=False)
    case = diagnosis([tmp_path / "late.csv"], window_s=2.0).prepare()
    fitted, held = (o.simulator for o in (case.observation, case.held_out))
    begun = min(float(simulator.windows.t[0, 0]) for simulator in (fitted, held))
    for simulator in (fitted, held):
        clock = simulator.windows.u[..., INPUTS.index("time")]
        real = np.diff(clock, axis=1, prepend=-np.inf) > 0.0
        np.testing.assert_allclose(clock[real], simulator.windows.t[real] - begun, atol=1e-9)
    assert held.nominal["duration"] == fitted.nominal["duration"]


def test_recordings_of_one_name_are_told_apart_by_their_paths(tmp_path: Path) -> None:
    for folder in ("monday", "tuesday"):
        (tmp_path / folder).mkdir()
    files = [written(tmp_path / folder / "drive.csv", k) for k, folder in enumerate(("monday", "tuesday"))]
    case = diagnosis(files, [written(tmp_path / "c.csv", 2)]).prepare()
    assert [one.recording for one in own_time(case.observation.simulator, 0.0, np.inf)] == [str(file) for file in files]
    assert case.held_out_names == ("c",)


def test_the_same_data_counts_once_whatever_its_file_is_called(tmp_path: Path) -> None:
    a = written(tmp_path / "a.csv", 0)
    copy = tmp_path / "copy.csv"
    copy.write_bytes(a.read_bytes())
    with pytest.raises(InputError, match="is also fitted"):
        diagnosis([a], [copy]).prepare()
    with pytest.raises(InputError, match="would count twice"):
        diagnosis([a, copy]).prepare()


def test_of_consecutive_files_the_longest_is_one_of_them(tmp_path: Path) -> None:
    a, b = written(tmp_path / "a.csv", 0), pd.read_csv(written(tmp_path / "b.csv", 1))
    b["time_s"] += 3600.0  # an hour later
    b.to_csv(tmp_path / "b.csv", index=False)
    simulator = diagnosis([a, tmp_path / "b.csv"], [written(tmp_path / "c.csv", 2)]).prepare().observation.simulator
    assert longest(simulator) == pytest.approx(10.0, abs=0.1)


def test_a_short_recording_loses_no_more_than_what_is_held_out_and_the_buffers(tmp_path: Path) -> None:
    # Ten seconds in blocks of 2.5 s, one of which is held out with a second's buffer on either side.
    windows = diagnosis([written(tmp_path / "a.csv", 0)]).prepare().observation.simulator.windows
    real = np.diff(windows.u[..., INPUTS.index("time")], axis=1, prepend=-np.inf) > 0.0
    assert real.sum() / windows.rate == pytest.approx(10.0 - 2.5 - 2.0, abs=0.1)


def test_a_place_is_not_in_a_recording_that_only_its_fading_end_reaches_into(tmp_path: Path) -> None:
    files = [written(tmp_path / name, k) for k, name in enumerate(("a.csv", "b.csv"))]
    simulator = diagnosis(files, [written(tmp_path / "c.csv", 2)]).prepare().observation.simulator
    (start, stop), *_ = stretches(simulator)
    over = Block("a_y", 9.5, 9.5 + (stop - start))
    assert [one.recording for one in own_time(simulator, over.from_s, over.to_s)] == ["a", "b"]
    assert [one.recording for one in lies_in(simulator, over)] == ["b"]


def test_a_recording_too_short_to_hold_anything_out_is_refused_with_the_length_that_it_takes(tmp_path: Path) -> None:
    whole = pd.read_csv(written(tmp_path / "whole.csv", 0))
    for name, seconds in (("short", 2.0), ("enough", 3.4)):
        whole[whole["time_s"] < seconds - 1e-6].to_csv(tmp_path / f"{name}.csv", index=False)
    # Half of it, less a buffer of 1 s, has to last for a warm-up of 0.5 s and ten samples at 50 Hz.
    with pytest.raises(InputError, match=r"2 s are too short to hold anything out; it takes 3\.4 s"):
        diagnosis([tmp_path / "short.csv"]).prepare()
    assert diagnosis([tmp_path / "enough.csv"]).prepare().held_out.anything


def test_fitted_and_held_out_blocks_of_several_drives_share_one_clock(tmp_path: Path) -> None:
    files = [written(tmp_path / f"{name}.csv", seed) for seed, name in enumerate("ab")]
    case = diagnosis(files, window_s=2.0).prepare()
    fitted, held = (o.simulator.windows for o in (case.observation, case.held_out))
    spans = {}
    for windows in (fitted, held):
        clock = windows.u[..., INPUTS.index("time")]
        for name in "ab":
            mine = (np.array(windows.recordings) == name)[:, None] & (np.diff(clock, axis=1, prepend=-1.0) > 0.0)
            assert np.ptp(clock[mine] - windows.t[mine]) < 1e-9  # one shift a recording
            spans.setdefault(name, []).append((clock[mine].min(), clock[mine].max()))
    assert min(start for start, _ in spans["a"]) == pytest.approx(0.0)
    assert max(stop for _, stop in spans["a"]) < min(start for start, _ in spans["b"])


def test_a_long_recording_leaves_short_ones_whole() -> None:
    def part(*seconds: float) -> list[tuple[RecordingFile, Recording]]:
        file = RecordingFile(path="x", channels=("a_y", "yaw_rate"))
        return [(file, Recording(name="x", rate=100.0, t=np.arange(round(100.0 * s)) / 100.0, channels={}, valid={},
                                 groups={}, source="x")) for s in seconds]  # fmt: skip

    assert _shares(part(20.0, 30.0)) == [1.0, 1.0]
    assert _shares(part(3600.0, 60.0)) == pytest.approx([540.0 / 3600.0, 1.0])
    assert _shares(part(3600.0, 1800.0)) == pytest.approx([300.0 / 3600.0, 300.0 / 1800.0])


def test_held_out_recordings_are_sampled_like_the_others(tmp_path: Path) -> None:
    slow = pd.read_csv(written(tmp_path / "b.csv", 1)).iloc[::2]
    slow.to_csv(tmp_path / "b.csv", index=False)
    with pytest.raises(InputError, match=r"recordings a and b differ in their rate: 50\.0 and 25\.0"):
        diagnosis([written(tmp_path / "a.csv", 0)], [tmp_path / "b.csv"], window_s=2.0).prepare()


def test_another_stretch_of_the_same_file_is_other_data(tmp_path: Path) -> None:
    a = written(tmp_path / "a.csv", 0)
    channels = ("a_x", "a_y", "yaw_rate")
    whole = RecordingFile(path=str(a), channels=channels)
    first, second = replace(whole, stop_s=5.0), replace(whole, start_s=5.0)
    case = replace(diagnosis([a], recording=first, window_s=2.0), recordings=[first], heldout=[second])
    assert case.prepare().apart
    with pytest.raises(InputError, match="is also fitted"):
        replace(case, heldout=[first]).prepare()


def test_a_stated_noise_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="noise: a diagnosis estimates it"):
        diagnosis([written(tmp_path / "a.csv", 0)], noise=ConstantNoise(std={"a_y": 0.1})).prepare()


def test_a_block_in_which_the_car_stands_holds_nothing_out_but_the_others_do(tmp_path: Path) -> None:
    # Of ten seconds those from 2.5 to 5 are held out.
    parked = pd.read_csv(written(tmp_path / "parked.csv", 0))
    parked.loc[parked["time_s"].between(2.3, 5.2), "v_x_mps"] = 0.0
    parked.to_csv(tmp_path / "parked.csv", index=False)
    case = diagnosis([tmp_path / "parked.csv", written(tmp_path / "b.csv", 1)], window_s=2.0)
    prepared = case.prepare()
    assert set(prepared.observation.simulator.windows.recordings) == {"parked", "b"}
    assert set(prepared.held_out.simulator.windows.recordings) == {"b"}
