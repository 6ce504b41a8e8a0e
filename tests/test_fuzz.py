"""Whatever a file holds, reading ends in a recording or in one line, soon and in little memory.

Files are those of a right drive with a few changes, so that many get past the first check; causes are counted, not
inputs: a failing example is shrunk to the smallest by hypothesis.
"""

import os
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from conftest import ROOT
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vehicle_sbi.data.mapping import mapping_file
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.vehicle import read as read_vehicle

EXAMPLES = int(os.environ.get("FUZZ_EXAMPLES", "150"))
SLOWEST_S = 5.0
MEMORY = 20  # times the file
BASE_MEMORY = 48 * 2**20  # of the libraries
VALID = 0.08  # of the inputs that have to be recordings, or nothing deep was reached
TOKENS = (
    "", "nan", "inf", "-1e300", "1e-320", "1" * 400, "0x10", "1_000", "１２", "é", "\x00", '"', '""', "'", ",", ";",
    "\t", "\n", "\r\n", "\n\n", "\ufeff", "=1+1", "[data]", "#", "NaT", "true", "null", "&a [*a]",
    "!!python/object:os.system", "{", "[", ":", " : ", "- ", "<<", "1e400", "-0.0", "time_s", "2026-01-01", "%",
    "\\", "${x}",
)  # fmt: skip
QUIET = settings(
    max_examples=EXAMPLES,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


def csv() -> str:
    t = np.arange(0.0, 2.0, 0.02)
    rows = zip(t, 0.05 * np.sin(3 * t), 15.0 + t, 1.5 * np.sin(3 * t), 0.1 * np.sin(3 * t), strict=True)
    lines = [",".join(f"{x:.6g}" for x in row) for row in rows]
    return "\n".join(["time_s,steering_rad,v_x_mps,a_y_mps2,yaw_rate_radps", *lines]) + "\n"


CSV = csv()
MAPPING = """steering: {column: swa, unit: deg, sign: -1}
v_x: {column: [vl, vr], scale: 0.5, unit: km/h}
a_y:
  - {column: ay, unit: g, optional: true}
  - {column: ay2, unit: m/s2}
"""
VEHICLE = (ROOT / "conf" / "vehicle" / "paper.yaml").read_text()


@st.composite
def changed(draw: st.DrawFn, text: str) -> str:
    """The text with one to four changes: something put in, taken out, said twice, or a line moved."""
    for _ in range(draw(st.integers(1, 4))):
        at, long = draw(st.integers(0, len(text))), draw(st.integers(0, 30))
        match draw(st.sampled_from(["put", "replace", "cut", "twice", "move", "end", "digit"])):
            case "put":
                text = text[:at] + draw(st.sampled_from(TOKENS)) + text[at:]
            case "replace":
                text = text[:at] + draw(st.sampled_from(TOKENS)) + text[at + long :]
            case "cut":
                text = text[:at] + text[at + long :]
            case "twice":
                text = text[: at + long] + text[at:]
            case "move":
                lines = text.splitlines(keepends=True)
                if lines:
                    lines.insert(at % len(lines), lines.pop(long % len(lines)))
                text = "".join(lines)
            case "end":
                text = text[: max(at, 1)]
            case "digit":
                text = text[:at] + draw(st.sampled_from("0123456789")) + text[at:]
    return text


def attempt(read: Callable[[], object]) -> bool:
    """Whether something was read, else one line told why; both soon, and in little memory."""
    begin = time.perf_counter()
    try:
        read()
        return True
    except InputError as error:
        said = str(error)
    finally:
        assert time.perf_counter() - begin < SLOWEST_S
    assert "\n" not in said
    assert len(said) < 1000
    return False


def fuzzed(path: Path, text: str, read: Callable[[], object]) -> None:
    """Read many changed copies of a text; enough of them are right."""
    counts: Counter[bool] = Counter()

    @QUIET
    @given(changed(text))
    def example(one: str) -> None:
        path.write_bytes(one.encode("utf-8", "surrogatepass"))
        counts[attempt(read)] += 1

    example()
    assert counts[True] >= VALID * counts.total(), counts


def test_csv(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    fuzzed(path, CSV, lambda: RecordingFile(path=path).load())


def test_a_csv_takes_memory_in_proportion_to_its_size(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    counts: Counter[bool] = Counter()
    attempt(lambda: RecordingFile(path=path).load())  # libraries are imported

    @settings(QUIET, max_examples=EXAMPLES // 5)
    @given(changed(CSV))
    def example(text: str) -> None:
        path.write_bytes(text.encode())
        tracemalloc.start()
        counts[attempt(lambda: RecordingFile(path=path).load())] += 1
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < BASE_MEMORY + MEMORY * len(text)

    example()


def test_vehicle_files(tmp_path: Path) -> None:
    path = tmp_path / "car.yaml"
    fuzzed(path, VEHICLE, lambda: read_vehicle(str(path)))


def test_mapping_files(tmp_path: Path) -> None:
    path, drive = tmp_path / "mine.yaml", tmp_path / "drive.csv"
    t = np.arange(0.0, 2.0, 0.02)
    table = [f"{x:.6g},{20 * np.sin(3 * x):.6g},{50 + x:.6g},{51 + x:.6g},{0.1 * np.sin(3 * x):.6g},1.0" for x in t]
    drive.write_text("\n".join(["time,swa,vl,vr,ay,ay2", *table]) + "\n")
    fuzzed(path, MAPPING, lambda: RecordingFile(path=drive, mapping=mapping_file(path)).load())


@pytest.mark.parametrize("name", ["fahrt_ä.csv", "走行.csv", "a b'c.csv", "$x;y.csv"])
def test_names_of_files_may_have_any_letters(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_text(CSV)
    assert len(RecordingFile(path=tmp_path / name).load().t) == 100


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (CSV.replace("0.02,", '"0.02,",', 1), "row 3, column 'time_s': '0.02,' is no number"),
        (CSV.replace("0.02,", '"0.02",7,', 1), "row 3"),
        ("&a [" * 60, "nested deeper than 50 levels"),
    ],
    ids=["quotes that shift columns", "a quoted row one field too long", "nesting"],
)
def test_known_attacks_get_a_line(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / ("drive.csv" if "," in text else "car.yaml")
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        RecordingFile(path=path).load() if path.suffix == ".csv" else read_vehicle(str(path))


@pytest.mark.parametrize(
    "line", ["scale: nan0.5", "scale: .nan", "scale: 0", "offset: [1]", "unit: 3", "wheel_radius: x"]
)
def test_a_mapping_s_numbers_are_numbers(tmp_path: Path, line: str) -> None:
    mapping = tmp_path / "mine.yaml"
    mapping.write_text(f"v_x: {{column: v_x_mps, {line}}}\n")
    (tmp_path / "drive.csv").write_text(CSV)
    with pytest.raises(InputError, match=f"v_x: {line.partition(':')[0]} = "):
        RecordingFile(path=tmp_path / "drive.csv", mapping=mapping_file(mapping)).load()
