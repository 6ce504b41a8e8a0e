"""Laws of reading, and the one line that each kind of unusable drive and each wrong setting gets."""

import os
import re
import tracemalloc
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from foreign_drive import refused
from hydra.utils import instantiate
from omegaconf import OmegaConf

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.cutting import cut
from vehicle_sbi.data.inspection.contents import contents
from vehicle_sbi.data.mapping import ChannelSource, built, mapping_file
from vehicle_sbi.data.readers import RecordingFile, flag_spikes, read
from vehicle_sbi.data.units import UNITS, factor
from vehicle_sbi.errors import InputError

ROOT = Path(__file__).parent.parent
RECORDINGS = Path(os.environ.get("VEHICLE_SBI_RECORDINGS", ROOT.parent / "shared/recordings"))

N = 400


def frame(n: int = N) -> pd.DataFrame:
    t = np.arange(n) / 100.0
    return pd.DataFrame(
        {"time_s": t, "steering_rad": 0.1 * t, "v_x_mps": 10.0 + t, "a_y_mps2": np.sin(t), "yaw_rate_radps": 0.2 * t}
    )


def saved(folder: Path, data: pd.DataFrame, name: str = "drive.csv") -> Path:
    path = folder / name
    data.to_csv(path, index=False) if name.endswith(".csv") else data.to_parquet(path)
    return path


@pytest.mark.parametrize("name", ["drive.csv", "drive.parquet"])
def test_native_files_come_back_as_they_were_written(tmp_path, name):
    data = frame()
    rec = read(saved(tmp_path, data, name))
    assert rec.rate == 100.0
    for channel in rec.channels:
        np.testing.assert_allclose(rec.channels[channel], data[CHANNELS[channel].column], rtol=1e-12, atol=1e-12)
        assert rec.valid[channel].all()
    assert rec.notes == ()
    assert rec.name == "drive"
    assert list(map(len, rec.files.values())) == [64]


@pytest.mark.parametrize("unit", UNITS)
def test_units_make_the_round_trip(unit):
    si, scale = UNITS[unit]
    assert factor(unit, si, "") == scale
    channel = next((name for name, c in CHANNELS.items() if c.unit == si), None)
    if channel is None:
        return
    values = np.array([-1.0, 0.0, 2.5])
    source = ChannelSource(column="x", unit=unit, sign=-1, scale=3.0, offset=0.5)
    np.testing.assert_allclose(-(source.to_si(channel, values, "") + 0.5) / scale / 3.0, values, atol=1e-12)


def test_units_agree_with_their_definitions():
    assert factor("km/h", "m/s", "") * 36.0 == pytest.approx(10.0)
    assert factor("deg", "rad", "") * 180.0 == pytest.approx(np.pi)
    assert factor("rpm", "rad/s", "") * 60.0 == pytest.approx(2.0 * np.pi)
    assert factor("g", "m/s²", "") == 9.80665


def test_a_channel_may_sum_columns_and_a_wheel_be_given_by_its_rim(tmp_path):
    path = saved(tmp_path, frame().assign(left=100.0, right=50.0, rim=7.0))
    rec = read(
        path,
        {
            "torque_front": ChannelSource(column=("left", "right"), unit="Nm"),
            "wheel_speed_fl": ChannelSource(column="rim", unit="km/h", wheel_radius=0.35),
        },
    )
    assert rec.channels["torque_front"] == pytest.approx(150.0)
    assert rec.channels["wheel_speed_fl"] == pytest.approx(7.0 / 3.6 / 0.35)
    assert rec.groups == {"torque_front": "can", "wheel_speed_fl": "wheel_speed"}


def test_a_time_shifted_file_gives_the_same_recording_later(tmp_path):
    data = frame()
    rec = read(saved(tmp_path, data))
    later = read(saved(tmp_path, data.assign(time_s=data.time_s + 5000.0), "later.csv"))
    np.testing.assert_allclose(later.t, rec.t + 5000.0)
    for name, values in rec.channels.items():
        np.testing.assert_allclose(later.channels[name], values, atol=1e-9)


def test_a_straight_line_is_resampled_exactly(tmp_path):
    t = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.015, 500))
    path = saved(tmp_path, pd.DataFrame({"time_s": t, "v_x_mps": 3.0 + 2.0 * t}))
    rec = RecordingFile(path=path, rate=77.0).load()
    assert rec.rate == 77.0
    np.testing.assert_allclose(np.diff(rec.t), 1 / 77.0)
    np.testing.assert_allclose(rec.channels["v_x"], 3.0 + 2.0 * rec.t, rtol=1e-12)
    assert rec.valid["v_x"].all()
    assert t[-1] - rec.t[-1] < 1 / 77.0
    assert any("resampled linearly to 77 Hz" in note for note in rec.notes)
    assert "v_x: low-passed at 30.8 Hz without phase, as its" in rec.notes[-1]


def vibrating(seconds: float = 20.0) -> pd.DataFrame:
    """A slow motion at 400 Hz on which an engine shakes with 1.5 m/s^2 at 49.3 Hz."""
    t = np.arange(0.0, seconds, 0.0025)
    return pd.DataFrame({"time_s": t, "a_y_mps2": np.sin(t) + 1.5 * np.sin(2.0 * np.pi * 49.3 * t)})


def test_what_a_slower_grid_cannot_show_does_not_come_back_as_slow_motion(tmp_path):
    """The filter leaves 1 / (1 + (49.3 / 20)^8) of the line, which sampled at 50 Hz would be one of 0.7 Hz."""
    rec = RecordingFile(path=saved(tmp_path, vibrating()), rate=50.0).load()
    inner = slice(25, -25)  # half a second, ten periods of the cutoff
    left = rec.channels["a_y"][inner] - np.sin(rec.t[inner])
    assert np.abs(left).max() < 1.5 / (1.0 + (49.3 / 20.0) ** 8) + 1e-4
    assert [note for note in rec.notes if note.startswith("a_y: low-passed at 20 Hz without phase, as its 400 Hz")]


@pytest.mark.parametrize("rate", [None, 400.0, 385.0, 800.0])
def test_a_grid_that_is_not_slower_changes_nothing(tmp_path, rate):
    data = vibrating(2.0)
    rec = RecordingFile(path=saved(tmp_path, data), rate=rate).load()
    np.testing.assert_array_equal(rec.channels["a_y"], np.interp(rec.t, data["time_s"], data["a_y_mps2"]))
    assert not [note for note in rec.notes if "low-passed" in note]


def test_gaps_part_what_is_low_passed_and_absent_samples_are_bridged(tmp_path):
    """What lies beyond a long gap does not matter, a piece that is too short stays, and a flag stays one."""
    data = vibrating(6.0).assign(brake_flag=lambda one: (one["time_s"] > 1.0).astype(float))
    data.loc[1000:1002, "a_y_mps2"] = np.nan
    gap = (data["time_s"] > 3.0) & (data["time_s"] < 4.0)
    short = (data["time_s"] >= 4.05) & (data["time_s"] < 5.0)
    data.loc[gap | short, "a_y_mps2"] = np.nan
    rec = RecordingFile(path=saved(tmp_path, data), rate=50.0).load()
    far = data.assign(a_y_mps2=data["a_y_mps2"] + 100.0 * (data["time_s"] > 3.5))
    other = RecordingFile(path=saved(tmp_path, far, "far.csv"), rate=50.0).load()
    before = rec.t < 3.0
    np.testing.assert_array_equal(rec.channels["a_y"][before], other.channels["a_y"][before])
    inner = (rec.t > 0.5) & (rec.t < 2.9)
    bridged = 1.5 * 0.0075 * 41.0  # 3 samples that err by a wave at most, under a filter whose response is 41 / s
    assert np.abs(rec.channels["a_y"] - np.sin(rec.t))[inner].max() < bridged
    unfiltered = (rec.t >= 4.0) & (rec.t < 4.045)
    np.testing.assert_allclose(
        rec.channels["a_y"][unfiltered], np.interp(rec.t[unfiltered], data["time_s"], vibrating(6.0)["a_y_mps2"])
    )
    assert {*np.unique(rec.channels["brake"])} == {0.0, 1.0}


def test_a_rate_is_inferred_from_the_median_step(tmp_path):
    data = frame()
    assert read(saved(tmp_path, data.assign(time_s=np.arange(N) / 30.0))).rate == pytest.approx(30.0)
    assert read(saved(tmp_path, data.drop(index=[50, 51, 200]))).rate == pytest.approx(100.0)


def test_time_units_and_cuts(tmp_path):
    path = saved(tmp_path, frame().assign(time_s=np.arange(N) * 10))
    rec = RecordingFile(path=path, time_unit="ms", start_s=1.0, stop_s=2.0).load()
    assert rec.rate == pytest.approx(100.0)
    assert (rec.t[0], rec.t[-1], len(rec.t)) == pytest.approx((1.0, 2.0, 101))


@pytest.mark.parametrize(("unit", "a_second"), [("ms", 1e3), ("us", 1e6), ("ns", 1e9)])
def test_times_that_are_no_seconds_are_refused_until_their_unit_is_stated(tmp_path, unit, a_second):
    times = (np.arange(N) * 0.01 * a_second).round().astype(int)
    path = saved(tmp_path, frame().assign(time_s=times))
    refused(path, f"column 'time_s' states no unit, .* too long for seconds: recording.time_unit={unit} says")
    assert RecordingFile(path=path, time_unit=unit).load().rate == pytest.approx(100.0)
    stated = saved(tmp_path, frame().assign(time_s=times).rename(columns={"time_s": f"Time [{unit}]"}), "stated.csv")
    assert read(stated).rate == pytest.approx(100.0)
    (clock,) = (
        one.clock for one in contents(saved(tmp_path, frame().assign(time_s=times).rename(columns={"time_s": "t"})))
    )
    assert clock.time_unit == unit


def test_a_slow_clock_is_read_if_seconds_are_stated(tmp_path):
    path = saved(tmp_path, frame().assign(time_s=10.0 * np.arange(N)))
    refused(path, "recording.time_unit=s that it is right")
    assert RecordingFile(path=path, time_unit="s").load().rate == pytest.approx(0.1)


def test_short_gaps_are_filled_and_long_ones_masked_and_both_noted(tmp_path):
    data = frame()
    data.loc[100:104, "v_x_mps"] = np.nan
    data.loc[200:249, "v_x_mps"] = np.nan
    rec = read(saved(tmp_path, data))
    v_x, valid = rec.channels["v_x"], rec.valid["v_x"]
    np.testing.assert_allclose(v_x[95:110], 10.0 + rec.t[95:110])
    assert np.flatnonzero(~valid).tolist() == [*range(100, 105), *range(200, 250)]
    assert np.flatnonzero(np.isnan(v_x)).tolist() == list(range(200, 250))
    assert rec.valid["a_y"].all()
    assert any(note.startswith("v_x: 5 samples filled linearly") for note in rec.notes)
    assert any(note.startswith("v_x: 50 samples missing in gaps that start at 2.00 s") for note in rec.notes)


def test_missing_rows_are_gaps_of_every_channel(tmp_path):
    rec = read(saved(tmp_path, frame().drop(index=range(100, 150))))
    assert len(rec.t) == N
    assert all(np.flatnonzero(~valid).tolist() == list(range(100, 150)) for valid in rec.valid.values())
    said = "all channels: 50 samples missing in gaps that start at 1.00 s; they are left out"
    assert [note for note in rec.notes if "missing" in note] == [said]


def test_a_stray_last_row_is_dropped(tmp_path):
    data = frame()
    data.loc[N - 1, "time_s"] = 9.0
    rec = read(saved(tmp_path, data))
    assert rec.t[-1] == pytest.approx((N - 2) / 100.0)
    assert "drive.csv: the last row, 5.02 s after the one before, dropped" in rec.notes


def test_of_rows_with_equal_times_the_first_is_kept_and_the_others_are_counted(tmp_path):
    data = frame()
    again = pd.concat([data[:100], data[99:100].assign(v_x_mps=0.0), data[100:200], data[199:200], data[199:]])
    rec = read(saved(tmp_path, again))
    whole = read(saved(tmp_path, data, "whole.csv"))
    for name, values in whole.channels.items():
        np.testing.assert_array_equal(rec.channels[name], values)
        assert rec.valid[name].all()
    said = "drive.csv: 3 of 403 rows repeat the time of the row above: of equal times the first is kept"
    assert rec.notes == (said,)
    jumped = again.assign(time_s=again.time_s + 1e6 * (np.arange(len(again)) > 150))
    refused(saved(tmp_path, jumped), "time jumps by 1e.06 s at row 153")


@pytest.mark.parametrize(("jump", "row"), [(86_400.0, 30), (1.7e9, 30), (1.7e9, 1)])
def test_a_clock_that_jumps_costs_no_memory_and_names_the_row(tmp_path, jump, row):
    data = frame()
    data.loc[row:, "time_s"] += jump
    path = saved(tmp_path, data)
    refused(path, re.escape(f"time jumps by {jump + 0.01:.6g} s at row {row + 2}, and {N} samples"))
    tracemalloc.start()
    refused(path)
    assert tracemalloc.get_traced_memory()[1] < 10 * path.stat().st_size + 10 * 2**20
    tracemalloc.stop()
    late = RecordingFile(path=path, start_s=jump).load()
    assert len(late.t) == N - row


def test_a_rate_far_above_the_files_is_refused(tmp_path):
    refused(saved(tmp_path, frame()), "recording.rate", rate=1e9)


def test_a_pause_of_minutes_is_kept(tmp_path):
    data = frame()
    data.loc[30:, "time_s"] += 600.0
    recording = read(saved(tmp_path, data))
    assert recording.t[-1] - recording.t[0] == pytest.approx(data["time_s"].iloc[-1])
    assert all(valid.sum() == N for valid in recording.valid.values())


def test_absent_ends_are_masked(tmp_path):
    data = frame()
    data.loc[:19, "a_y_mps2"] = np.nan
    data.loc[380:, "a_y_mps2"] = np.nan
    valid = read(saved(tmp_path, data)).valid["a_y"]
    assert np.flatnonzero(valid).tolist() == list(range(20, 380))


def test_files_of_one_drive_are_merged_on_the_stretch_they_share(tmp_path):
    t = np.arange(-0.5, 3.5, 0.0096)
    phone = saved(tmp_path, pd.DataFrame({"clock": t, "down": -2.0 * t}), "phone.csv")
    file = RecordingFile(
        path=saved(tmp_path, frame()),
        also=[{"path": phone, "time": "clock", "mapping": {"a_z": {"column": "down", "sign": -1}}}],
    )
    rec = file.load()
    assert rec.t[0] == 0.0
    assert rec.t[-1] == pytest.approx(3.49)
    np.testing.assert_allclose(rec.channels["a_z"], 2.0 * rec.t, atol=1e-12)
    assert rec.valid["a_z"].all()
    assert "phone.csv" in rec.source
    assert len(rec.files) == 2
    with pytest.raises(InputError, match="v_x also comes from another file"):
        RecordingFile(
            path=file.path, also=[RecordingFile(path=file.path, mapping={"v_x": {"column": "v_x_mps"}})]
        ).load()
    saved(tmp_path, pd.DataFrame({"clock": t + 100.0, "down": t}), "phone.csv")
    with pytest.raises(InputError, match="no samples from"):
        file.load()


def test_the_first_candidate_that_the_file_has_is_taken_and_what_is_optional_may_lack(tmp_path):
    mapping = {
        "v_x": [{"column": "wheel"}, {"column": "v_x_mps", "note": "it is the GPS speed"}],
        "a_z": {"column": "az", "optional": True},
    }
    rec = read(saved(tmp_path, frame()), mapping)
    assert list(rec.channels) == ["v_x"]
    assert rec.notes == ("v_x: it is the GPS speed",)
    with pytest.raises(InputError, match="unknown column 'wheel'; known: "):
        read(saved(tmp_path, frame()), {"v_x": [{"column": "wheel"}, {"column": "axle"}]})
    with pytest.raises(InputError, match="has none of the columns of its mapping, which are all optional: a_z"):
        read(saved(tmp_path, frame()), {"a_z": mapping["a_z"]})


def test_a_mapping_may_be_a_file(tmp_path):
    path, mapping = saved(tmp_path, frame()), tmp_path / "car.yaml"
    mapping.write_text("v_x: {column: v_x_mps, unit: km/h}\n")
    np.testing.assert_allclose(read(path, mapping).channels["v_x"], (10.0 + np.arange(N) / 100.0) / 3.6)
    for content, message in (("a: [", "not valid YAML"), ("- 1", "must hold lines such as"), ("v_x: 3", "must hold")):
        mapping.write_text(content)
        with pytest.raises(InputError, match=message):
            read(path, mapping)
    with pytest.raises(InputError, match=r"mapping: .*nowhere.yaml: no such file"):
        read(path, tmp_path / "nowhere.yaml")


def test_clocks_of_several_files_are_kept_and_noted(tmp_path):
    later = pd.DataFrame({"time_s": np.arange(0.31, 3.9, 0.02), "down": 1.0})
    other = {"path": saved(tmp_path, later, "imu.csv"), "mapping": {"a_z": {"column": "down"}}}
    notes = RecordingFile(path=saved(tmp_path, frame()), also=[other]).load().notes
    assert "clock of imu.csv begins 0.310 s after that of drive.csv, in steps of 20 ms against 10 ms" in notes


@pytest.mark.parametrize("preset", sorted((ROOT / "conf/mapping").glob("*.yaml")), ids=lambda path: path.stem)
def test_presets_name_channels_and_settings_that_there_are(preset):
    for name, given in mapping_file(preset).items():
        candidates: Any = [given] if isinstance(given, dict) else given
        for one in candidates:
            built(ChannelSource, one, name).to_si(name, np.zeros(3), preset.stem)


@pytest.mark.parametrize("seed", range(5))
def test_spikes_are_flagged_and_noise_is_not(seed):
    rng = np.random.default_rng(seed)
    signal = np.sin(np.arange(1000) / 50.0) + rng.normal(0.0, 0.02, 1000)
    assert not flag_spikes(signal).any()
    signal[[100, 500]] += [2.0, -1.0]
    assert np.flatnonzero(flag_spikes(signal)).tolist() == [100, 500]


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_steps_pulses_ramps_and_held_samples_are_no_spikes(noise):
    n = np.arange(1000)
    shapes = [n >= 500, (n >= 500) & (n < 502), np.maximum(n - 500, 0), n // 5 * 5, np.sin(n / 100) > 0, n * 0 + 1]
    for shape in shapes:
        assert not flag_spikes(shape + np.random.default_rng(1).normal(0.0, 1.0, 1000) * noise).any()


def test_a_spike_is_filled_but_not_valid(tmp_path):
    data = frame()
    data.loc[123, "yaw_rate_radps"] = 9.0
    rec = read(saved(tmp_path, data))
    assert np.flatnonzero(~rec.valid["yaw_rate"]).tolist() == [123]
    assert rec.channels["yaw_rate"][123] == pytest.approx(0.2 * 1.23)
    assert "yaw_rate: 1 single-sample spikes left out at 1.23 s" in rec.notes


HEAD = "time_s,v_x_mps\n"
BAD_FILES = {
    "header only": (HEAD, "has 0 data rows"),
    "no time": (
        "clock,v_x_mps\n0,1\n1,1\n2,1",
        "no column of times is recognised among clock, v_x_mps; name it with recording.time=COLUMN",
    ),
    "no native column": ("time_s,speed\n0,1\n1,1\n2,1", "no native column and no mapping"),
    "two times": (HEAD + "0,1\n1,1\n1,1\n1,1", "has 4 data rows at 2 times; a recording needs at least 3"),
    "time goes back after it stood": (HEAD + "0,1\n1,1\n1,1\n0.5,1\n2,1", "row 5, column 'time_s': 0.5 s lies before"),
    "time goes back": (HEAD + "0,1\n1,1\n0.5,1\n2,1", "row 4, column 'time_s': 0.5 s lies before the row above"),
    "time absent": (HEAD + "0,1\n1,1\n,1\n2,1", "row 4, column 'time_s': no time"),
    "mostly absent": (HEAD + "0,1\n1,\n2,\n3,\n4,1", "row 3, column 'v_x_mps': v_x holds no number here and in 60%"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_drive_that_makes_no_recording_is_one_clear_line(tmp_path, case):
    content, message = BAD_FILES[case]
    path = tmp_path / "drive.csv"
    path.write_text(content)
    with pytest.raises(InputError, match=message) as error:
        read(path)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"mapping": {"a_y": {"column": "a_y_mps"}}}, "unknown column 'a_y_mps'; known: a_y_mps2"),
        ({"mapping": {"a_y": {"column": "a_y_mps2", "unit": "m/s3"}}}, "channel a_y: unknown unit 'm/s3'; known: m/s"),
        ({"mapping": {"a_y": {"column": "a_y_mps2", "unit": "deg"}}}, "'deg' does not convert to m/s²; allowed: .*g"),
        ({"mapping": {"a_y": {"column": "a_y_mps2", "sign": 2}}}, "sign 2 is neither 1 nor -1"),
        ({"mapping": {"a_y": {"column": "a_y_mps2", "group": "cab"}}}, "unknown group 'cab'; known: can"),
        (
            {"mapping": {"a_y": {"column": "a_y_mps2", "units": "g"}}},
            "channel a_y: unknown setting 'units'; known: unit",
        ),
        ({"mapping": {"a_y": {"column": "a_y_mps2", "wheel_radius": 0.3}}}, "wheel_radius"),
        ({"mapping": {"ay": {"column": "a_y_mps2"}}}, "mapping: unknown channel 'ay'; known: a_y"),
        ({"mapping": {"a_y": {"unit": "g"}}}, "channel a_y: no value for column"),
        ({"time_unit": "h"}, "column time_s: unknown unit 'h'"),
        ({"time": "clock"}, "unknown column 'clock'"),
        ({"rate": -1.0}, "rate -1 Hz is not positive"),
        ({"start_s": 50.0}, "no samples from 50 to 3.99 s; its files hold 0 to 3.99 s"),
    ],
)
def test_a_wrong_setting_is_one_clear_line(tmp_path, settings, message):
    with pytest.raises(InputError, match=message) as error:
        RecordingFile(path=saved(tmp_path, frame()), **settings).load()
    assert "drive.csv" in str(error.value)
    assert "\n" not in str(error.value)


CONFIGURED = {
    "volvo_s90_slalom": (3578, 100.0),
    "volvo_s90_slalom_imu": (3578, 100.0),
    "toyota_rav4_car": (5999, 100.0),
    "toyota_rav4_phone": (5999, 100.0),
    "ferrari_250lm": (30000, 100.0),
    "dart_sine_steering": (494, 10.0),
}


@pytest.mark.parametrize("name", CONFIGURED)
def test_configured_recordings_load_and_turn_left_when_steered_left(name):
    config = OmegaConf.load(ROOT / "conf/recording" / f"{name}.yaml").recording
    OmegaConf.update(config, "path", str(config.path).replace("../shared/recordings", str(RECORDINGS)))
    for other in config.also if "also" in config else []:
        other.path = str(other.path).replace("../shared/recordings", str(RECORDINGS))
    if not Path(config.path).exists():
        pytest.skip(f"{config.path} is not here")
    file = instantiate(config)
    rec = file.load()
    assert (len(rec.t), rec.rate) == CONFIGURED[name]
    windows = cut(
        rec, drive=file.drive, channels=file.channels, length_s=5.0,
        steering_ratio=16.0, v_min=file.v_min, start_s=rec.t[0],
    )  # fmt: skip
    steering, v_x = windows.u[..., 0].ravel(), windows.u[..., 3].ravel()
    yaw_rate = windows.y[windows.channels.index("yaw_rate")]
    good = np.isfinite(yaw_rate)
    assert np.corrcoef((v_x * steering)[good], yaw_rate[good])[0, 1] > 0.6
    if "a_y" in windows.channels:
        a_y = windows.y[windows.channels.index("a_y")]
        assert np.corrcoef((v_x * yaw_rate)[good], a_y[good])[0, 1] > 0.9
