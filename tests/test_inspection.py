"""An inspection says what a file holds, guesses a mapping by names and units, and writes files to edit."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml
from test_plausibility import RATE, RECORDINGS, drive, healthy, recording

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.formats.table import Table
from vehicle_sbi.data.inspection.contents import Column, contents
from vehicle_sbi.data.inspection.excitation import ONE_SIDED, excitation
from vehicle_sbi.data.inspection.guess import guess
from vehicle_sbi.data.inspection.inspection import Inspection, inspect
from vehicle_sbi.data.inspection.spoken import next_command, spoken
from vehicle_sbi.data.inspection.units import split
from vehicle_sbi.data.inspection.written import ADVICE, mapping_text, vehicle_text, write
from vehicle_sbi.data.mapping import ChannelSource
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.vehicle import MEANINGS, Vehicle
from vehicle_sbi.physics.vehicle import read as read_vehicle


def column(name: str, *, size: float = 0.1, unit: str | None = None) -> Column:
    values = size * np.sin(np.arange(100.0))
    return Column(
        name=name,
        clock="",
        unit=unit or split(name)[1],
        unit_from="from the name",
        low=-size,
        high=size,
        absent=0.0,
        values=values,
    )


def csv(path: Path, columns: dict[str, np.ndarray]) -> RecordingFile:
    pd.DataFrame(columns).to_csv(path, index=False)
    return RecordingFile(path=path)


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("Speed [km/h]", "km/h"), ("G Lat (g)", "g"), ("yaw_rate_deg_s", "deg/s"), ("yaw_rate_radps", "rad/s"),
        ("a_y_mps2", "m/s²"), ("speed_kmh", "km/h"), ("steering_wheel_deg", "deg"), ("Accel in m/s^2", "m/s²"),
        ("omega_rpm", "rpm"), ("speed_ms", "m/s"), ("v_x", None), ("acc x (IMU)", None), ("ALat1", None),
        ("accel_1", None),
    ],
)  # fmt: skip
def test_a_unit_is_read_from_the_end_of_a_name(name: str, unit: str | None) -> None:
    assert split(name)[1] == unit


@pytest.mark.parametrize(
    ("name", "channel"),
    [
        ("SWA", "steering_wheel"), ("SteeringWheelAngle [deg]", "steering_wheel"),
        ("steering_wheel_deg", "steering_wheel"),
        ("road_wheel_angle_rad", "steering"), ("steering_tire_angle", "steering"), ("VehSpdLgt", "v_x"),
        ("Lenkradwinkel", "steering_wheel"), ("LW_Winkel", "steering_wheel"), ("Lenkwinkel", "steering"),
        ("Geschwindigkeit", "v_x"), ("Fahrzeuggeschwindigkeit", "v_x"), ("Radgeschwindigkeit", None),
        ("Querbeschleunigung", "a_y"), ("Längsbeschleunigung", "a_x"), ("Gierrate", "yaw_rate"),
        ("Gierwinkelgeschwindigkeit", "yaw_rate"), ("Wankrate", "roll_rate"), ("Nickrate", "pitch_rate"),
        ("Lenkradwinkelgeschwindigkeit", None), ("Windgeschwindigkeit", None),
        ("VehicleSpeed", "v_x"), ("v_x_mps", "v_x"), ("velocity", "v_x"), ("GPS Speed (km/h)", "v_x"),
        ("twist.linear.x", "v_x"), ("vel encoder", "v_x"), ("Lat._Vel.", "v_y"), ("ALgt1", "a_x"), ("X_Accel", "a_x"),
        ("acc x (IMU)", "a_x"), ("linear_acceleration.x", "a_x"), ("G Long (g)", "a_x"), ("LongAcc", "a_x"),
        ("ALat1", "a_y"), ("latacc", "a_y"), ("accel_y", "a_y"), ("G_lat", "a_y"), ("Z_Accel", "a_z"),
        ("YawRate1", "yaw_rate"), ("yaw_rate_dps", "yaw_rate"), ("gyro_z", "yaw_rate"),
        ("angular_velocity.z", "yaw_rate"),
        ("RollRate1", "roll_rate"), ("gyr_y", "pitch_rate"), ("FLwhlspd", "wheel_speed_fl"),
        ("wheel_rr_mps", "wheel_speed_rr"),
        ("WheelSpeed_FR", "wheel_speed_fr"), ("ws_rl_rpm", "wheel_speed_rl"),
        ("wheel_speed_front_left", "wheel_speed_fl"),
        *((one.column, name) for name, one in CHANNELS.items() if name != "brake"),
        ("Steering torque", None), ("SteeringWheelSpeed", None), ("engine_speed_rpm", None), ("wheel_slip_fl", None),
        ("latitude", None), ("YawRate_quality", None), ("Lat_Jerk", None), ("accelerator_pedal", None), ("yaw", None),
        ("desired_speed", None), ("time", None), ("altitude_m", None),
    ],
)  # fmt: skip
def test_a_name_in_common_use_is_recognised(name: str, channel: str | None) -> None:
    assert [one.channel for one in guess([column(name)])] == ([channel] if channel else [])


@pytest.mark.parametrize(("size", "channel"), [(0.3, "steering"), (3.0, "steering_wheel")])
def test_a_steering_angle_is_the_wheels_if_it_turns_further_than_wheels_do(size: float, channel: str) -> None:
    (one,) = guess([column("steering angle", size=size)])
    assert (one.channel, one.sure) == (channel, "unsure")


def test_a_unit_of_another_kind_is_no_match_and_a_rims_speed_asks_for_the_radius() -> None:
    assert guess([column("yaw_rate", unit="m/s")]) == ()
    (wheel,) = guess([column("wheel_fl [km/h]")])
    assert wheel.needs_radius
    (wheel,) = guess([column("wheel_fl [rpm]")])
    assert not wheel.needs_radius


def test_a_unit_that_is_not_understood_is_said_and_does_not_hide_the_name(tmp_path: Path) -> None:
    t = np.arange(200) / 50.0
    columns = {
        "Zeit [UTC]": t, "Lenkradwinkel [Grad]": 40 * np.sin(t), "Geschwindigkeit [Knoten pro h]": 20 + t,
        "latacc (x)": np.sin(t), "Wheel speed (FL)": 60 + t,
    }  # fmt: skip
    found = inspect(csv(tmp_path / "a.csv", columns))
    assert found.unread is None
    guesses = {one.channel: one for one in found.guesses}
    assert {*guesses} == {"steering_wheel", "v_x", "a_y", "wheel_speed_fl"}
    assert (guesses["steering_wheel"].unit, guesses["steering_wheel"].sure) == ("deg", "sure")
    assert guesses["v_x"].unit_from == "assumed, as unit 'Knoten pro h' is not understood"
    assert "unit 'Knoten pro h' is not understood" in spoken(found)
    assert "unit 'Knoten pro h' is not understood" in mapping_text(found)


def test_the_surest_name_is_taken_and_the_others_are_listed() -> None:
    (one,) = guess([column("a_y_raw"), column("latacc"), column("accel_y_mps2")])
    assert one.columns == ("accel_y_mps2",)
    assert one.alternatives == ("latacc", "a_y_raw")
    opposite = column("YawRate2")
    (one,) = guess([column("YawRate"), Column(**{**vars(opposite), "values": -opposite.values})])
    assert one.alternatives == ("YawRate2 (of opposite sign)",)


def test_the_torques_of_both_wheels_are_summed_and_an_axis_to_the_right_is_turned() -> None:
    (torque,) = guess([column("PtTqAtW_FL"), column("PtTqAtW_FR")])
    assert (torque.channel, torque.columns) == ("torque_front", ("PtTqAtW_FL", "PtTqAtW_FR"))
    signs = {one.channel: one.sign for one in guess([column("a_forward"), column("a_right"), column("w_down")])}
    assert signs == {"a_x": 1, "a_y": -1, "yaw_rate": -1}


def test_rates_and_gaps_of_a_clock_are_said(tmp_path: Path) -> None:
    t = np.delete(np.arange(1000) / 50.0, np.arange(300, 400))
    csv(tmp_path / "a.csv", {"Time [ms]": 1000.0 * t, "accel_y": np.sin(t), "constant": 0.0 * t})
    (table,) = contents(tmp_path / "a.csv")
    assert (table.clock.time, table.clock.time_unit, table.clock.rows) == ("Time [ms]", "ms", 900)
    assert table.clock.rate == pytest.approx(50.0)
    assert np.allclose(table.clock.gaps, [(5.98, 2.02)])
    said = spoken(inspect(RecordingFile(path=tmp_path / "a.csv")))
    assert "900 rows in 19.98 s, usually at 50 Hz, 1 gap, the longest 2.02 s from 5.98 s" in said
    assert "constant: constant" in said
    assert "missing: steering, v_x, yaw_rate" in said


@pytest.mark.parametrize(("scale", "unit"), [(1.0, "s"), (1e3, "ms"), (1e6, "us"), (1e9, "ns")])
def test_the_unit_of_times_is_told_from_the_usual_step(tmp_path: Path, scale: float, unit: str) -> None:
    t = 1.7e9 + np.arange(300) / 100.0
    csv(tmp_path / "a.csv", {"stamp_time": np.round(scale * t, 3), "v_x": t - t[0]})
    assert contents(tmp_path / "a.csv")[0].clock.time_unit == unit


def test_a_file_without_times_says_how_to_name_them(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no column of times is recognised among a, b; name it with recording.time="):
        inspect(csv(tmp_path / "a.csv", {"a": np.arange(5.0), "b": np.arange(5.0)}))


def foreign(path: Path, *, flip: bool = False) -> RecordingFile:
    """A right drive in names and units of a data logger, a_y with the wrong sign if asked."""
    x = healthy("bends")
    columns = {
        "Time [ms]": 1000.0 * np.arange(len(x["v_x"])) / RATE,
        "SteeringWheelAngle [deg]": np.degrees(x["steering_wheel"]),
        "Vehicle Speed (km/h)": 3.6 * x["v_x"],
        "G Lat (g)": (-1.0 if flip else 1.0) * x["a_y"] / 9.80665,
        "gyro_z_deg_s": np.degrees(x["yaw_rate"]),
        "engine_rpm": 2000.0 + x["v_x"],
    }
    return csv(path, columns)


def test_foreign_names_and_units_become_the_right_drive(tmp_path: Path) -> None:
    found = inspect(foreign(tmp_path / "a.csv"))
    assert found.wrong == ()
    assert found.unread is None
    assert set(found.channels) == {"steering_wheel", "v_x", "a_y", "yaw_rate"}
    assert found.missing == ()
    recording = reread(found, tmp_path)
    for name in found.channels:
        assert np.allclose(recording.channels[name], healthy("bends")[name])


def reread(found: Inspection, folder: Path):
    """The recording by the mapping that an inspection writes."""
    mapping, _ = write(found, folder)
    clock = found.tables[0].clock
    settings = yaml.safe_load(mapping.read_text())
    return RecordingFile(path=found.path, mapping=settings, time=clock.time, time_unit=clock.time_unit).load()


def test_what_looks_wrong_is_said_and_not_mended(tmp_path: Path) -> None:
    found = inspect(foreign(tmp_path / "a.csv", flip=True))
    (line,) = found.wrong
    assert line.startswith("a_y has the opposite sign of v_x times yaw_rate")
    assert f"- {line}" in spoken(found)
    assert "sign" not in yaml.safe_load(write(found, tmp_path)[0].read_text())["a_y"]


def test_what_reading_leaves_out_is_said(tmp_path: Path) -> None:
    x = drive()
    a_y = x["a_y"].copy()
    a_y[700] += 50.0 * np.abs(np.diff(a_y)).max()
    found = inspect(csv(tmp_path / "a.csv", {"time_s": np.arange(2000) / RATE, **x, "a_y": a_y}))
    said = spoken(found).partition("what was changed in reading\n")[2].partition("\n\n")[0]
    assert f"a_y: 1 single-sample spikes left out at {700 / RATE:.2f} s" in said


def test_a_given_mapping_is_checked_instead_of_a_guess(tmp_path: Path) -> None:
    x = drive()
    path = csv(
        tmp_path / "a.csv", {"time_s": np.arange(2000) / RATE, "p": x["v_x"], "q": x["yaw_rate"], "r": -x["a_y"]}
    )
    mapping = {"v_x": {"column": "p"}, "yaw_rate": {"column": "q"}, "a_y": {"column": "r"}}
    found = inspect(RecordingFile(path=path.path, mapping=mapping))
    assert found.given
    assert "is a_y or yaw_rate flipped?" in found.wrong[0]


def test_a_mapping_that_takes_another_quantity_for_a_channel_is_said(tmp_path: Path) -> None:
    turning = drive()["yaw_rate"]
    table = Table(path=tmp_path / "a.csv", columns={"turn": turning}, time="time_s", units={"turn": "rad/s"})
    assert ChannelSource(column="turn", unit="rad").overridden("steering", table) == ["turn"]
    assert ChannelSource(column="turn", unit="deg/s").overridden("yaw_rate", table) == []
    assert ChannelSource(column="turn").overridden("yaw_rate", table) == []


def test_a_stretch_that_ends_before_it_begins_is_refused(tmp_path: Path) -> None:
    path = csv(tmp_path / "a.csv", {"time_s": np.arange(2000) / RATE, "v_x_mps": drive()["v_x"]}).path
    with pytest.raises(InputError, match="start_s = 12 does not lie before stop_s = 4"):
        RecordingFile(path=path, start_s=12.0, stop_s=4.0).load()


def test_a_drive_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    t = np.arange(100) / 10.0
    t[50] = t[48]
    found = inspect(csv(tmp_path / "a.csv", {"time_s": t, "v_x": t}))
    assert "lies before the row above" in str(found.unread)
    assert "1 times the clock does not go on" in spoken(found)


def test_a_german_logger_s_file_is_read_as_windows_writes_it(tmp_path: Path) -> None:
    path = tmp_path / "fahrt.csv"
    t = np.arange(200) / 50.0
    rows = [f"{x:.2f};{40 * np.sin(x):.3f};{60 + x:.3f};{3 * np.sin(x):.4f}".replace(".", ",") for x in t]
    path.write_bytes(
        "\r\n".join(["Zeit[s];Lenkradwinkel[°];Geschwindigkeit[km/h];Querbeschl[m/s²]", *rows]).encode("cp1252")
    )
    found = inspect(RecordingFile(path=str(path)))
    assert [one.channel for one in found.guesses] == ["steering_wheel", "v_x", "a_y"]
    assert found.guesses[0].columns == ("Lenkradwinkel[°]",)
    text = mapping_text(found)
    assert '# yaw_rate: {column: "its column", unit: deg/s}' in text
    assert "# a_y:" not in text


def test_the_vehicle_file_fails_until_it_is_edited(tmp_path: Path) -> None:
    _, path = write(inspect(foreign(tmp_path / "drive.csv")), tmp_path)
    with pytest.raises(InputError, match=r"vehicle 'drive': m = 'a number, or null'; a number has to stand there"):
        read_vehicle(str(path))
    text = path.read_text().replace('m: "a number, or null"', "m: 1500").replace('"a number, or null"', "null")
    path.write_text(text)
    with pytest.raises(InputError, match=r"drive_front = '1 front, 0 rear, between if both'; a number has"):
        read_vehicle(str(path))
    text = text.replace('"1 front, 0 rear, between if both"', "0")
    path.write_text(text)
    vehicle = read_vehicle(str(path))
    assert (vehicle.name, vehicle.m, vehicle.steering_ratio, vehicle.drive_front) == ("drive", 1500, None, 0)
    assert set(MEANINGS) == set(Vehicle.__dataclass_fields__) - {"name"}
    assert all("# [" in line for line in text.splitlines() if line.split(":")[0] in MEANINGS)


def test_nothing_is_overwritten_unless_asked(tmp_path: Path) -> None:
    found = inspect(foreign(tmp_path / "drive.csv"))
    (tmp_path / "drive.vehicle.yaml").write_text("m: 1500")
    with pytest.raises(InputError, match=r"drive.vehicle.yaml: exists, left as it is; overwrite=true"):
        write(found, tmp_path)
    assert not (tmp_path / "drive.mapping.yaml").exists()
    write(found, tmp_path, overwrite=True)
    assert "m: 1500" not in (tmp_path / "drive.vehicle.yaml").read_text()


def test_the_next_command_names_the_files_and_the_times(tmp_path: Path) -> None:
    found = inspect(foreign(tmp_path / "drive.csv"))
    said = next_command(found, Path("m.yaml"), Path("v.yaml"), command="vehicle-sbi diagnose")
    assert said.startswith("vehicle-sbi diagnose recording=")
    assert " mapping=m.yaml vehicle=v.yaml" in said
    assert "recording.time_unit=ms" in said


@pytest.mark.parametrize(
    ("file", "channels"),
    [
        ("ferrari_250lm/targa66_first_300s.csv", 6),
        ("volvo_s90/S90__038.VBO", 12),
        ("toyota_rav4/car.csv", 5),
        ("toyota_rav4/phone_accelerometer.csv", 3),
        ("toyota_rav4/phone_gyroscope.csv", 3),
    ],
)
def test_real_files_are_mapped_by_their_names_and_contradict_nothing(file: str, channels: int) -> None:
    if not (RECORDINGS / file).exists():
        pytest.skip(f"{RECORDINGS / file} is not here")
    found = inspect(RecordingFile(path=RECORDINGS / file))
    assert len(found.channels) == channels
    assert found.wrong == ()
    assert found.unread is None


def turned(*, right: float, peak: float, spread: float) -> dict[str, np.ndarray]:
    """Bends to both sides, those to the right with a part of the acceleration [g], at a speed of 15 m/s that swings."""
    t = np.arange(4000) / RATE
    bends = np.sin(t)
    a_y = 9.81 * peak * np.where(bends > 0.0, bends, right * bends)
    v_x = 15.0 * (1.0 + spread * np.sqrt(2.0) * np.sin(0.3 * t))
    return {"steering": 0.01 * bends, "v_x": v_x, "a_y": a_y, "yaw_rate": a_y / v_x}


@pytest.mark.parametrize(
    ("drive", "said"),
    [
        ({"right": 1.0, "peak": 0.6, "spread": 0.5}, []),
        ({"right": 1.0, "peak": 0.2, "spread": 0.5}, ["gentle, up to 0.20 g"]),
        ({"right": 0.1, "peak": 0.6, "spread": 0.5}, ["91% of the turning is to the left"]),
        ({"right": 1.0, "peak": 0.6, "spread": 0.05}, ["nearly one speed"]),
    ],
)
def test_what_a_drive_is_too_gentle_or_too_uniform_for_is_said(drive: dict[str, float], said: list[str]) -> None:
    channels = turned(**drive)
    first, *rest = excitation(recording(channels))
    assert first.startswith(f"lateral acceleration from -{drive['right'] * drive['peak']:.2f} to {drive['peak']:.2f} g")
    assert [line.startswith(begun) for line, begun in zip(rest, said, strict=True)] == [True] * len(said)
    assert excitation(recording({**channels, "a_y": np.full(4000, np.nan)})) == excitation(recording(channels))


def test_the_other_side_is_named_where_the_drive_turns_to_the_right() -> None:
    mirrored = {
        name: -x if name in ("a_y", "yaw_rate") else x for name, x in turned(right=0.1, peak=0.6, spread=0.5).items()
    }
    assert any(line.startswith("91% of the turning is to the right") for line in excitation(recording(mirrored)))
    assert 0.5 < ONE_SIDED < 0.91


def test_the_vehicle_file_says_what_to_state_of_a_dry_road_and_states_nothing_itself() -> None:
    text = vehicle_text("car", steered=True)
    for name, advice in ADVICE.items():
        (line,) = [line for line in text.splitlines() if line.startswith(f"{name}:")]
        assert advice in line
        assert yaml.safe_load(text)[name] is None
