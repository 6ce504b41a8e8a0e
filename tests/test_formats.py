"""Files come back as they were written, whatever their format, and one that is cut or foreign gets one clear line."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.data.formats.table import Table
from vehicle_sbi.data.inspection.contents import contents
from vehicle_sbi.data.mapping import mapping_file
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.errors import InputError

ROOT = Path(__file__).parent.parent

FRAME = pd.DataFrame({"time_s": np.arange(50) / 100.0, "a_y_mps2": np.sin(np.arange(50) / 100.0), "v_x_mps": 10.0})

VBO = """File created on 01/01/2020 @ 00:00

[header]
time
Lat acc.

[column names]
sats time v-kmh  Lat._acc.\x20

[data]
"""


def only(path: Path) -> Table:
    (table,) = read_tables(path)
    return table


def vbo(folder: Path, rows: list[str], head: str = VBO) -> Path:
    path = folder / "drive.VBO"
    path.write_text(head + "\n".join(rows) + "\n", encoding="latin-1")
    return path


@pytest.mark.parametrize("name", ["drive.csv", "drive.parquet"])
def test_columns_come_back_as_they_were_written(tmp_path, name):
    path = tmp_path / name
    FRAME.to_csv(path, index=False) if name.endswith(".csv") else FRAME.to_parquet(path)
    table = only(path)
    assert list(table.columns) == list(FRAME)
    for column in FRAME:  # pandas reads decimals to an ulp or two, 2e-16 each
        np.testing.assert_allclose(table.numbers(str(column)), FRAME[column], rtol=1e-15)


@pytest.mark.parametrize("separator", ";\t")
def test_semicolons_and_tabs_separate_too(tmp_path, separator):
    FRAME.to_csv(tmp_path / "drive.csv", sep=separator, index=False)
    np.testing.assert_allclose(only(tmp_path / "drive.csv").numbers("a_y_mps2"), FRAME["a_y_mps2"], rtol=1e-15)


def test_an_empty_cell_is_absent_and_so_is_infinity(tmp_path):
    (tmp_path / "drive.csv").write_text("time_s,v_x_mps\n0,1\n1,\n2,inf\n3,-\n4,--\n")
    np.testing.assert_array_equal(only(tmp_path / "drive.csv").numbers("v_x_mps"), [1.0, *4 * [np.nan]])


def test_dates_are_no_numbers(tmp_path):
    FRAME.assign(time_s=pd.Timestamp("2020-01-01")).to_parquet(tmp_path / "drive.parquet")
    with pytest.raises(InputError, match="column 'time_s' holds dates; it must hold numbers"):
        only(tmp_path / "drive.parquet").numbers("time_s")


def test_time_may_be_the_index_that_pandas_wrote(tmp_path):
    FRAME.set_index("time_s").to_parquet(tmp_path / "drive.parquet")
    table = only(tmp_path / "drive.parquet")
    assert {*table.columns} == {*FRAME}
    np.testing.assert_array_equal(table.numbers("time_s"), FRAME["time_s"])


DATES = pd.Timestamp("2024-05-01 12:00:00.5") + pd.to_timedelta(FRAME["time_s"], unit="s")
SINCE_1970 = 1_714_564_800.5 + FRAME["time_s"]  # date -u -d '2024-05-01 12:00:00' +%s
WRITTEN_DATES = {
    "csv": (DATES, ".csv"),
    "csv with T and a comma": (DATES.astype(str).str.replace(" ", "T").str.replace(".", ","), ".csv"),
    "csv with the day first": (DATES.dt.strftime("%d.%m.%Y %H:%M:%S.%f"), ".csv"),
    "csv of another zone": (DATES.dt.tz_localize("UTC").dt.tz_convert("Asia/Tokyo"), ".csv"),
    "parquet": (DATES, ".parquet"),
    "parquet of another zone": (DATES.dt.tz_localize("UTC").dt.tz_convert("America/New_York"), ".parquet"),
}


@pytest.mark.parametrize("case", WRITTEN_DATES)
def test_dates_as_time_are_seconds_since_the_epoch(tmp_path, case):
    """A double holds them to 0.24 us."""
    dates, suffix = WRITTEN_DATES[case]
    path, frame = tmp_path / f"drive{suffix}", FRAME.assign(time_s=dates)
    frame.to_csv(path, index=False) if suffix == ".csv" else frame.to_parquet(path)
    found = only(path).dates("time_s")
    assert found is not None
    np.testing.assert_allclose(found, SINCE_1970, rtol=0.0, atol=5e-7)
    recording = RecordingFile(path=path).load()
    assert recording.rate == pytest.approx(100.0, rel=1e-4)
    np.testing.assert_allclose(recording.t, SINCE_1970, rtol=0.0, atol=1e-6)
    (held,) = contents(path, time="time_s")
    assert held.clock.time_unit == "s"
    assert held.clock.start == pytest.approx(SINCE_1970[0], abs=1e-6)


def test_durations_as_time_are_seconds(tmp_path):
    FRAME.assign(time_s=pd.to_timedelta(FRAME["time_s"], unit="s")).to_parquet(tmp_path / "drive.parquet")
    np.testing.assert_allclose(RecordingFile(path=tmp_path / "drive.parquet").load().t, FRAME["time_s"], atol=1e-9)


def test_times_of_day_are_seconds_also_across_midnight(tmp_path):
    evening = pd.Timestamp("2024-05-01 23:59:59.8") + pd.to_timedelta(FRAME["time_s"], unit="s")
    texts = evening.dt.strftime("%H:%M:%S.%f")
    FRAME.assign(time_s=texts).to_csv(tmp_path / "drive.csv", index=False)
    since_midnight = FRAME["time_s"] + 86399.8
    assert since_midnight.max() > 86400.0
    recording = RecordingFile(path=tmp_path / "drive.csv").load()
    np.testing.assert_allclose(recording.t, since_midnight, atol=1e-6)
    texts[7] = "25:61"
    FRAME.assign(time_s=texts).to_csv(tmp_path / "odd.csv", index=False)
    with pytest.raises(InputError, match=r"row 9, column 'time_s': '25:61' is no date$"):
        RecordingFile(path=tmp_path / "odd.csv").load()


@pytest.mark.parametrize("name", ["Uhrzeit", "Logged at"])
def test_the_column_of_times_may_hold_dates_under_any_name(tmp_path, name):
    frame = FRAME.assign(time_s=DATES.dt.strftime("%H:%M:%S.%f")).rename(columns={"time_s": name})
    frame[frame.columns[::-1]].to_csv(tmp_path / "drive.csv", index=False)
    recording = RecordingFile(path=tmp_path / "drive.csv").load()
    np.testing.assert_allclose(recording.t, SINCE_1970 % 86400.0, atol=1e-6)


@pytest.mark.parametrize("encoding", ["utf-16", "utf-8-sig", "cp1252"])
def test_a_text_is_read_in_the_encoding_of_its_writer(tmp_path, encoding):
    (tmp_path / "drive.csv").write_text("time_s,v_x_mps,Öltemperatur [°C]\n0,1,80\n1,2,81\n", encoding=encoding)
    table = only(tmp_path / "drive.csv")
    assert [*table.columns] == ["time_s", "v_x_mps", "Öltemperatur [°C]"]
    np.testing.assert_array_equal(table.numbers("v_x_mps"), [1.0, 2.0])


def test_what_is_no_date_among_dates_is_one_line(tmp_path):
    texts = DATES.astype(str)
    texts[7] = "noon"
    FRAME.assign(time_s=texts).to_csv(tmp_path / "drive.csv", index=False)
    with pytest.raises(InputError, match=r"row 9, column 'time_s': 'noon' is no date$"):
        RecordingFile(path=tmp_path / "drive.csv").load()


def test_vbo_time_runs_across_midnight(tmp_path):
    clock = [f"2359{59 + k / 100:06.3f}" if k < 100 else f"0000{k / 100 - 1:06.3f}" for k in range(200)]
    table = only(vbo(tmp_path, [f"010 {time} {36.0 + k:+.3f} -0.5" for k, time in enumerate(clock)]))
    np.testing.assert_allclose(table.numbers(table.time), np.arange(200) / 100.0, atol=1e-9)
    np.testing.assert_allclose(table.numbers("v-kmh"), 36.0 + np.arange(200))


def test_trailing_dots_and_blanks_of_a_name_do_not_count(tmp_path):
    table = only(vbo(tmp_path, ["010 000000.000 1 -0.5"]))
    assert table.has("Lat._acc")
    assert table.numbers("Lat._acc") == table.numbers("Lat._acc. ") == [-0.5]


def text(content: str | bytes, name: str = "drive.csv"):
    def write(folder: Path) -> Path:
        path = folder / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


HEAD = "time_s,v_x_mps\n"
BAD_FILES = {
    "absent": (lambda folder: folder / "drive.csv", "drive.csv: no such file"),
    "folder": (lambda folder: folder, "is no file"),
    "suffix": (text("x", "drive.xyz"), r"'\.xyz' are not read; those that are: \.csv, \.txt, \.parquet, \.vbo, \.mat"),
    "empty": (text(""), "drive.csv: is empty"),
    "blank": (text("\n\n"), "drive.csv: is empty"),
    "binary": (text(b"PAR1\0\0\1\2"), "is binary"),
    "html": (text("<!DOCTYPE html>\n<p>not found</p>"), "is HTML"),
    "prose": (text("Dear reader\nthis is a letter\n"), "row 1: is no CSV"),
    "no column": (text("time_s,speed\n0,1"), "unknown column 'v_x_mps'; known: speed, time_s"),
    "truncated": (text(HEAD + "0,1\n1,1\n2"), "row 4 has 1 fields, the header names 2 columns .is the file truncated"),
    "too wide": (text(HEAD + "0,1\n1,1,5\n2,2"), "row 3 has 3 fields, the header names 2 columns$"),
    "no number": (text(HEAD + "0,1\n1,fast\n2,2"), "row 3, column 'v_x_mps': 'fast' is no number"),
    "parquet": (text("time_s", "drive.parquet"), "cannot be read as Parquet"),
    "vbo of another kind": (text("a,b\n1,2\n", "drive.vbo"), r"no section \[column names\] and no \[data\]"),
    "vbo cut": (
        lambda folder: vbo(folder, ["1 000000.0 1 1", "1 000001.0 1 1", "1 00"]),
        "row 13 has 2 fields, .*trunc",
    ),
    "vbo of two drives": (
        lambda folder: vbo(folder, ["1 000000.0 1 1", "[data]", "1 000001.0 1 1"]),
        r"a second section \[data\]",
    ),
    "a cell of megabytes": (text(HEAD + "0," + "x" * 5_000_000), "column 'v_x_mps': 'x+…"),
    "a name of megabytes": (text("time_s," + "x" * 5_000_000 + "\n0,1\n1,2\n"), "unknown column 'v_x_mps'; known: .*…"),
    "a quoted cell of megabytes": (text(HEAD + '0,"' + "x" * 5_000_000 + '"\n1,2'), "'x+…"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_one_clear_line(tmp_path, case):
    make, message = BAD_FILES[case]
    with pytest.raises(InputError, match=message) as error:
        only(make(tmp_path)).numbers("v_x_mps")
    assert "\n" not in str(error.value)
    assert len(str(error.value)) < 1000


def test_a_name_that_comes_twice_is_noted(tmp_path):
    table = only(text("time_s,v_x_mps,v_x_mps,\n0,1,2,\n1,2,3,\n")(tmp_path))
    assert [*table.columns][:3] == ["time_s", "v_x_mps", "v_x_mps (2)"]
    assert table.notes == (f"{table.path}: v_x_mps comes twice; of a name the second column is called 'NAME (2)'",)
    np.testing.assert_array_equal(table.numbers("v_x_mps"), [1.0, 2.0])


T = np.arange(300) / 50.0


def logger_text(kind: str) -> str:
    """The same drive as MoTeC i2, AiM and commaSteeringControl write it."""
    speed, lateral, yaw = 72.0 + T, np.sin(T) / 9.80665, np.degrees(0.2 * np.cos(T))
    if kind == "comma":
        head = "t,latActive,steeringPressed,vEgo,steeringAngleDeg,latAccelLocalizer,epsFwVersion"
        rows = [
            f"{t},True,False,{v / 3.6},{y},{-9.80665 * a},b'x'"
            for t, v, a, y in zip(T, speed, lateral, yaw, strict=True)
        ]
        return "\n".join([head, *rows]) + "\n"
    names = ["Time", "Ground Speed", "G Force Lat", "Gyro Yaw Velocity", "Engine RPM", "Coolant"]
    units = ["s", "km/h", "G", "deg/s", "rpm", "C"]
    preamble = {
        "motec": ['"Format","MoTeC CSV File",,,"Workbook",""', '"Vehicle","car",,,"Worksheet",""',
                  '"Sample Rate","50.000","Hz",,"Range","all"',
                  '"Duration","6.000","s",,,', "", '"Beacon Markers","95.1 193.2"'],
        "aim": ['"Format","AiM CSV File"', '"Session","Track"', '"Sample Rate","50"',
                '"Beacon Markers","95.1","193.2","288.1","380.0","470.5"', '"Segment Times","1:35.1","1:38.1"', ""],
    }[kind]  # fmt: skip
    quoted = [",".join(f'"{field}"' for field in fields) for fields in (names, units)]
    rows = [
        ",".join(f'"{field:.6f}"' for field in (t, v, a, y, 3000.0, 80.0))
        for t, v, a, y in zip(T, speed, lateral, yaw, strict=True)
    ]
    between = ["", ""] if kind == "motec" else [""]
    return "\n".join([*preamble, *between, *quoted, *between, *rows]) + "\n"


@pytest.mark.parametrize("kind", ["motec", "aim"])
def test_loggers_put_a_preamble_before_the_header_and_units_after_it(tmp_path, kind):
    table = only(text(logger_text(kind))(tmp_path))
    assert table.time == "Time"
    assert (table.unit("Ground Speed"), table.unit("G Force Lat"), table.unit("Time")) == ("km/h", "G", "s")
    np.testing.assert_allclose(table.numbers("Time"), T, atol=1e-6)
    np.testing.assert_allclose(table.numbers("G Force Lat") * 9.80665, np.sin(T), atol=1e-5)
    lines = logger_text(kind).splitlines()
    assert lines[table.first_row - 1].startswith('"0.000000"')


@pytest.mark.parametrize("kind", ["motec", "comma"])
def test_presets_read_what_loggers_write(tmp_path, kind):
    path = text(logger_text(kind))(tmp_path)
    mapping = dict(mapping_file(ROOT / f"conf/mapping/{'motec' if kind == 'motec' else 'openpilot'}.yaml"))
    if kind == "motec":
        del mapping["steering_wheel"]  # which this car does not log
    recording = RecordingFile(path=path, mapping=mapping).load()
    np.testing.assert_allclose(recording.channels["v_x"], (72.0 + T) / 3.6, atol=1e-6)
    np.testing.assert_allclose(recording.channels["a_y"], np.sin(T), atol=1e-5)
    if kind == "motec":
        np.testing.assert_allclose(recording.channels["yaw_rate"], 0.2 * np.cos(T), atol=1e-6)
        assert "units as drive.csv states them: v_x km/h, a_y G, yaw_rate deg/s" in recording.notes
    else:
        assert any("taken as positive to the right" in note for note in recording.notes)


def test_a_cut_logger_row_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"row 31. has 4 fields, the header names 6 columns .is the file truncated"):
        only(text(logger_text("motec").rstrip().rsplit(",", 2)[0])(tmp_path))


def test_units_may_stand_in_brackets_and_decimals_be_commas(tmp_path):
    table = only(text("Time [ms];v (km/h);axis (IMU)\n0,0;1,5;2\n10,0;2,5;3\n")(tmp_path))
    assert (table.time, table.unit("Time [ms]"), table.unit("v (km/h)"), table.unit("axis (IMU)")) == (
        "Time [ms]", "ms", "km/h", "",
    )  # fmt: skip
    assert table.numbers("v (km/h)").tolist() == [1.5, 2.5]


@pytest.mark.parametrize("other", ["01.05.2024", "Start v1.2", "12:00:00.5", ""])
def test_a_date_or_a_remark_has_no_decimal_mark(tmp_path, other):
    rows = "".join(f"{other};0,{k:02d};{50 + k},125\n" for k in range(8))
    table = only(text("Remark;Zeit [s];v [km/h]\n" + rows)(tmp_path))
    np.testing.assert_allclose(table.numbers("Zeit [s]"), np.arange(8) / 100.0)
    np.testing.assert_allclose(table.numbers("v [km/h]"), 50.125 + np.arange(8))


def test_a_unit_in_brackets_that_is_not_understood_is_said(tmp_path):
    """Square brackets hold units alone, so it is refused; round ones may hold a remark, so SI is assumed and noted."""
    path = text("Zeit [s];v [furlong];w (furlong);a[0]\n0;1;2;3\n1;2;3;4\n2;3;4;5\n")(tmp_path)
    square = RecordingFile(path=path, mapping={"v_x": {"column": "v [furlong]"}})
    with pytest.raises(InputError, match=r"unit 'furlong' is not understood; a unit in the mapping .* m/s, km/h"):
        square.load()
    stated = RecordingFile(path=path, mapping={"v_x": {"column": "v [furlong]", "unit": "m/s"}}).load()
    assert not [note for note in stated.notes if "furlong" in note]
    round_ones = {"v_x": {"column": "w (furlong)"}, "a_y": {"column": "a[0]"}}
    notes = RecordingFile(path=path, mapping=round_ones).load().notes
    assert "v_x: unit 'furlong' is not understood, m/s assumed" in notes
    assert not [note for note in notes if note.startswith("a_y")]


def test_a_unit_of_time_that_is_not_understood_is_refused_with_what_helps(tmp_path):
    path = text("Zeit [UTC];v_x_mps\n0;1\n1;2\n2;3\n")(tmp_path)
    with pytest.raises(InputError, match=r"unit 'UTC' is not understood; recording.time_unit counts instead: s, ms"):
        RecordingFile(path=path).load()
    assert len(RecordingFile(path=path, time_unit="s").load().t) == 3


def test_a_logger_may_have_a_decimal_comma_in_every_field(tmp_path):
    """More commas than semicolons in a row of numbers, and a first row of whole ones."""
    table = only(text("Zeit;Lenkradwinkel;Gierrate\ns;°;°/s\n0;0;-1\n0,02;1,5;-2,25\n0,04;3,0;-0,5\n")(tmp_path))
    assert (table.time, table.unit("Lenkradwinkel"), table.unit("Gierrate")) == ("Zeit", "°", "°/s")
    assert table.numbers("Lenkradwinkel").tolist() == [0.0, 1.5, 3.0]
    assert table.numbers("Gierrate").tolist() == [-1.0, -2.25, -0.5]


def test_a_vbo_states_units_in_its_header_and_in_their_own_section(tmp_path):
    head = VBO.replace("time\nLat acc.\n", "satellites\ntime\nvelocity kmh\nLat acc.\n\n[channel units]\ng\n")
    table = only(vbo(tmp_path, ["010 000000.000 1 -0.5"], head))
    assert (table.unit("v-kmh"), table.unit("Lat._acc.")) == ("km/h", "g")
