"""Files come back as they were written, whatever their format, and one that is cut or foreign gets one clear line."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from vehicle_sbi.data.formats import read_table
from vehicle_sbi.errors import InputError

FRAME = pd.DataFrame({"time_s": np.arange(50) / 100.0, "a_y_mps2": np.sin(np.arange(50) / 100.0), "v_x_mps": 10.0})

VBO = """File created on 01/01/2020 @ 00:00

[header]
time
Lat acc.

[column names]
sats time v-kmh  Lat._acc.\x20

[data]
"""


def vbo(folder: Path, rows: list[str], head: str = VBO) -> Path:
    path = folder / "drive.VBO"
    path.write_text(head + "\n".join(rows) + "\n", encoding="latin-1")
    return path


@pytest.mark.parametrize("name", ["drive.csv", "drive.parquet"])
def test_columns_come_back_as_they_were_written(tmp_path, name):
    path = tmp_path / name
    FRAME.to_csv(path, index=False) if name.endswith(".csv") else FRAME.to_parquet(path)
    table = read_table(path)
    assert list(table.columns) == list(FRAME)
    for column in FRAME:  # pandas reads decimals to an ulp or two, 2e-16 each
        np.testing.assert_allclose(table.numbers(str(column)), FRAME[column], rtol=1e-15)


@pytest.mark.parametrize("separator", ";\t")
def test_semicolons_and_tabs_separate_too(tmp_path, separator):
    FRAME.to_csv(tmp_path / "drive.csv", sep=separator, index=False)
    np.testing.assert_allclose(read_table(tmp_path / "drive.csv").numbers("a_y_mps2"), FRAME["a_y_mps2"], rtol=1e-15)


def test_an_empty_cell_is_absent_and_so_is_infinity(tmp_path):
    (tmp_path / "drive.csv").write_text("time_s,v_x_mps\n0,1\n1,\n2,inf\n")
    np.testing.assert_array_equal(read_table(tmp_path / "drive.csv").numbers("v_x_mps"), [1.0, np.nan, np.nan])


def test_dates_are_no_numbers(tmp_path):
    FRAME.assign(time_s=pd.Timestamp("2020-01-01")).to_parquet(tmp_path / "drive.parquet")
    with pytest.raises(InputError, match="column 'time_s' holds dates; it must hold numbers"):
        read_table(tmp_path / "drive.parquet").numbers("time_s")


def test_vbo_time_runs_across_midnight(tmp_path):
    clock = [f"2359{59 + k / 100:06.3f}" if k < 100 else f"0000{k / 100 - 1:06.3f}" for k in range(200)]
    table = read_table(vbo(tmp_path, [f"010 {time} {36.0 + k:+.3f} -0.5" for k, time in enumerate(clock)]))
    np.testing.assert_allclose(table.numbers(table.time), np.arange(200) / 100.0, atol=1e-9)
    np.testing.assert_allclose(table.numbers("v-kmh"), 36.0 + np.arange(200))


def test_trailing_dots_and_blanks_of_a_name_do_not_count(tmp_path):
    table = read_table(vbo(tmp_path, ["010 000000.000 1 -0.5"]))
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
    "suffix": (text("x", "drive.mf4"), r"'\.mf4' are not read; those that are: \.csv, \.txt, \.parquet, \.vbo"),
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
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_a_bad_file_is_one_clear_line(tmp_path, case):
    make, message = BAD_FILES[case]
    with pytest.raises(InputError, match=message) as error:
        read_table(make(tmp_path)).numbers("v_x_mps")
    assert "\n" not in str(error.value)
