"""Whatever a file or a command line holds, it ends in a recording or a study, or in one line, soon, in little memory.

Files are those of a right drive with a few changes, so that many get past the first check; causes are counted, not
inputs: a failing example is shrunk to the smallest by hypothesis, and what was told is counted by kind (`pytest -rP`).
"""

from _entry.command_line import spelled_out
from _entry.construction import check_construction
from _entry.sentences import sentence

import io
import os
import re
import shlex
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pandas as pd
import pytest
from conftest import ROOT
from hydra import compose, initialize_config_dir
from hydra.utils import instantiate
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf
from test_can import MAPPING as OF_CAN
from test_can import database, frames
from test_formats import vbo
from test_matlab import MAPPING as OF_MATLAB
from test_matlab import written as matlab
from test_mdf import MAPPING as OF_MDF
from test_mdf import written as mdf
from test_rosbag import AUTOWARE
from test_rosbag import written as bag

from vehicle_sbi.command import CONF
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
def changed(draw: st.DrawFn, text: str, most: int = 4) -> str:
    """The text with so many changes at most: something put in, taken out, said twice, or a line moved."""
    for _ in range(draw(st.integers(1, most))):
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


@st.composite
def changed_bytes(draw: st.DrawFn, content: bytes) -> bytes:
    """The content with one to four changes: a bit, a byte, a stretch that is cut, said twice or zero, an early end."""
    for _ in range(draw(st.integers(1, 4))):
        at, long = draw(st.integers(0, max(len(content) - 1, 0))), draw(st.integers(1, 64))
        before, stretch, after = content[:at], content[at : at + long], content[at + long :]
        match draw(st.sampled_from(["bit", "byte", "cut", "twice", "zero", "end"])):
            case "bit":
                flipped = bytes([content[at] ^ (1 << draw(st.integers(0, 7)))]) if content else b""
                content = before + flipped + content[at + 1 :]
            case "byte":
                content = before + bytes([draw(st.integers(0, 255))]) + content[at + 1 :]
            case "cut":
                content = before + after
            case "twice":
                content = before + stretch + stretch + after
            case "zero":
                content = before + bytes(len(stretch)) + after
            case "end":
                content = before
    return content


def attempt(read: Callable[[], object]) -> str:
    """The line that was told, empty where something was read; both soon."""
    begin = time.perf_counter()
    try:
        read()
        return ""
    except InputError as error:
        said = str(error)
    finally:
        assert time.perf_counter() - begin < SLOWEST_S
    assert "\n" not in said
    assert 0 < len(said) < 1000
    return said


def kind_of(said: str) -> str:
    """A line without what differs from input to input: paths, numbers, and what is quoted."""
    return re.sub(r"'[^']*'|\"[^\"]*\"|/\S*|[-+\d][\w.+-]*", "…", said)


def fuzzed(changes: st.SearchStrategy, read: Callable[..., object], examples: int = EXAMPLES) -> None:
    """Read many changed copies; enough of them are right."""
    kinds: Counter[str] = Counter()

    @settings(QUIET, max_examples=examples)
    @given(changes)
    def example(one: object) -> None:
        kinds[kind_of(attempt(lambda: read(one)))] += 1

    example()
    print(
        f"{kinds.total()} inputs, {kinds['']} of them read; {len(kinds) - 1} kinds of lines, the most frequent of them:"
    )
    print("\n".join(f"{count:6d} {kind[:100]}" for kind, count in kinds.most_common(6) if kind))
    assert kinds[""] >= VALID * kinds.total(), kinds


def of_text(path: Path, text: str, read: Callable[[], object], most: int = 4) -> None:
    """The same of a text in a file."""

    def one(changed_text: str) -> None:
        path.write_bytes(changed_text.encode("utf-8", "surrogatepass"))
        read()

    fuzzed(changed(text, most), one)


def test_csv(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    of_text(path, CSV, lambda: RecordingFile(path=path).load())


def test_a_csv_takes_memory_in_proportion_to_its_size(tmp_path: Path) -> None:
    path = tmp_path / "drive.csv"
    attempt(lambda: RecordingFile(path=path).load())  # libraries are imported

    @settings(QUIET, max_examples=EXAMPLES // 5)
    @given(changed(CSV))
    def example(text: str) -> None:
        path.write_bytes(text.encode())
        tracemalloc.start()
        attempt(lambda: RecordingFile(path=path).load())
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < BASE_MEMORY + MEMORY * len(text)

    example()


def test_vehicle_files(tmp_path: Path) -> None:
    path = tmp_path / "car.yaml"
    of_text(path, VEHICLE, lambda: read_vehicle(str(path)))


def test_mapping_files(tmp_path: Path) -> None:
    path, drive = tmp_path / "mine.yaml", tmp_path / "drive.csv"
    t = np.arange(0.0, 2.0, 0.02)
    table = [f"{x:.6g},{20 * np.sin(3 * x):.6g},{50 + x:.6g},{51 + x:.6g},{0.1 * np.sin(3 * x):.6g},1.0" for x in t]
    drive.write_text("\n".join(["time,swa,vl,vr,ay,ay2", *table]) + "\n")
    of_text(path, MAPPING, lambda: RecordingFile(path=drive, mapping=mapping_file(path)).load(), most=2)


def test_vbo(tmp_path: Path) -> None:
    rows = [f"012 {120000.0 + t:.2f} {54.0 + t:.3f} {0.3 * np.sin(3 * t):.4f}" for t in np.arange(0.0, 2.0, 0.02)]
    path = vbo(tmp_path, rows)
    mapping = {"v_x": {"column": "v-kmh"}, "a_y": {"column": "Lat._acc", "unit": "g"}}
    of_text(path, path.read_text("latin-1"), lambda: RecordingFile(path=path, mapping=mapping).load())


def parquet(folder: Path) -> Path:
    pd.read_csv(io.StringIO(CSV)).to_parquet(folder / "drive.parquet")
    return folder / "drive.parquet"


def mcap(folder: Path) -> Path:
    return next(bag(folder, "ros2 mcap").glob("*.mcap"))


def blf(folder: Path) -> Path:
    path = folder / "drive.blf"
    with can.BLFWriter(path, compression_level=0) as writer:
        for message in frames(database(folder)):
            writer(message)
    return path


BINARY: dict[str, tuple[Callable[[Path], Path], dict[str, object]]] = {
    "parquet": (parquet, {}),
    "mat": (lambda folder: matlab(folder, compressed=False), {"mapping": OF_MATLAB}),
    "mdf": (mdf, {"mapping": OF_MDF}),
    "mcap": (mcap, {"mapping": AUTOWARE}),
    "blf": (blf, {"mapping": OF_CAN}),
}


@pytest.mark.parametrize("kind", BINARY)
def test_binary_files(tmp_path: Path, kind: str) -> None:
    write, options = BINARY[kind]
    path = write(tmp_path)
    settings = options | ({"dbc": str(tmp_path / "car.dbc")} if kind == "blf" else {})

    def read(content: bytes) -> None:
        path.write_bytes(content)
        RecordingFile(path=path, **settings).load()  # pyright: ignore[reportArgumentType]

    fuzzed(changed_bytes(path.read_bytes()), read, EXAMPLES // 5)


WORDS = "prior=default estimator=nsf model=single_track rounds.last=3000 noise=paper seed=7 manoeuvre=paper_strong"


def test_command_lines() -> None:
    def compose_and_construct(text: str) -> None:
        try:
            words = shlex.split(text)
        except ValueError:  # the shell would have asked for the quotation's end
            return
        try:
            with initialize_config_dir(config_dir=str(CONF), version_base=None):
                cfg = compose("config", overrides=spelled_out(words))
            check_construction(OmegaConf.to_container(cfg, resolve=True))
            instantiate(cfg.study)
            instantiate(cfg.rounds)
        except Exception as error:
            line = sentence(error)
            if line is None:
                raise
            raise InputError(line) from None

    compose_and_construct(WORDS)  # libraries are imported
    fuzzed(changed(WORDS), compose_and_construct, EXAMPLES // 5)


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


@pytest.mark.parametrize("candidate", ["null", "1", "speed", "[{column: a_y_mps2}]"])
def test_a_candidate_of_a_mapping_is_settings(tmp_path: Path, candidate: str) -> None:
    mapping = tmp_path / "mine.yaml"
    mapping.write_text(f"a_y: [{candidate}]\n")
    (tmp_path / "drive.csv").write_text(CSV)
    with pytest.raises(InputError, match=r"channel a_y: must be settings, \{name: value\}, not "):
        RecordingFile(path=tmp_path / "drive.csv", mapping=mapping_file(mapping)).load()
