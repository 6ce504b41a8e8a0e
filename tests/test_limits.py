"""Files that unpack to many times their size are refused in one line, before they fill the memory."""

import bz2
import json
import sqlite3
import struct
import subprocess
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import can
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from asammdf import MDF, Signal
from foreign_drive import refused
from lz4 import frame as lz4
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore
from scipy.io import savemat

from vehicle_sbi.data.formats.limits import ALWAYS, MOST_FRAMES, RATIO, Budget, Zlib
from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.data.inspection.inspection import inspect
from vehicle_sbi.data.inspection.spoken import spoken
from vehicle_sbi.data.readers import RecordingFile, read
from vehicle_sbi.errors import InputError

ROOT = Path(__file__).parent.parent
SIZE = 400 * 2**20  # [bytes] that a bomb unpacks to at least: more than ALWAYS
ZEROS = bytes(2**20)
SECONDS = 5.0
READ = """
import json, resource, sys, time
from pathlib import Path
import vehicle_sbi.data.readers as readers
from vehicle_sbi.data.formats.registry import read_tables
from vehicle_sbi.errors import InputError
small = sys.argv[2]
try: read_tables(Path(small))
except InputError: pass
before, began = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.perf_counter()
try:
    for table in read_tables(Path(sys.argv[1]), sys.argv[3] or None):
        for name in table.columns:
            table.columns[name]
    said = "read"
except InputError as error:
    said = str(error)
seconds = time.perf_counter() - began
print(json.dumps([said, seconds, 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)]))
"""


def deflated(size: int = SIZE) -> bytes:
    packer = zlib.compressobj(1)
    return b"".join([*(packer.compress(ZEROS) for _ in range(size // len(ZEROS))), packer.flush()])


def parquet_of_runs(folder: Path) -> Path:
    pq.write_table(pa.table({"time_s": np.zeros(SIZE // 8, dtype=np.int8)}), folder / "a.parquet", compression="zstd")
    return folder / "a.parquet"


def parquet_of_texts(folder: Path) -> Path:
    texts = pa.DictionaryArray.from_arrays(pa.array(np.zeros(SIZE // 10000, dtype=np.int32)), pa.array(["x" * 10000]))
    table = pa.table({"time_s": np.arange(len(texts)) / 100.0, "said": texts})
    pq.write_table(table, folder / "a.parquet", store_schema=False)
    return folder / "a.parquet"


def ros2(plugin: StoragePlugin, mode: CompressionMode) -> Callable[[Path], Path]:
    def write(folder: Path) -> Path:
        writer = Writer2(folder / "bag", version=9, storage_plugin=plugin)
        writer.set_compression(mode, CompressionFormat.ZSTD)
        with writer:
            types = get_typestore(Stores.ROS2_HUMBLE)
            connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=types)
            writer.write(connection, 1, bytes(SIZE))
        return folder / "bag"

    return write


def ros1(folder: Path) -> Path:
    writer = Writer1(folder / "a.bag")
    writer.set_compression(Writer1.CompressionFormat.LZ4)
    with writer:
        connection = writer.add_connection("/imu", "sensor_msgs/msg/Imu", typestore=get_typestore(Stores.ROS1_NOETIC))
        writer.write(connection, 1, bytes(SIZE))
    return folder / "a.bag"


def mdf(folder: Path) -> tuple[Path, bytearray]:
    t = np.arange(100) / 100.0
    file = MDF(version="4.10")
    file.append([Signal(t, t, name="a", unit="m/s")], common_timebase=True)
    file.save(folder / "a.mf4", overwrite=True)
    file.close()
    return folder / "a.mf4", bytearray((folder / "a.mf4").read_bytes())


def mdf_packed(stated: int) -> Callable[[Path], Path]:
    """The data of the group is a DZ block at the end of the file, which states its size rightly or not."""

    def write(folder: Path) -> Path:
        path, data = mdf(folder)
        packed = deflated()
        data += bytes(-len(data) % 8)
        struct.pack_into("<Q", data, data.find(b"##DG") + 24 + 16, len(data))
        data += struct.pack("<4s4xQQ2sBxIQQ", b"##DZ", 48 + len(packed), 0, b"DT", 0, 0, stated, len(packed)) + packed
        path.write_bytes(data)
        return path

    return write


def mdf_of_nothing(folder: Path) -> Path:
    """A group that states 10^9 records."""
    path, data = mdf(folder)
    struct.pack_into("<Q", data, data.find(b"##CG") + 24 + 48 + 8, 10**9)
    path.write_bytes(data)
    return path


def matlab(folder: Path) -> Path:
    savemat(folder / "a.mat", {"time": np.zeros(SIZE // 8), "a": np.zeros(3)}, do_compression=True)
    return folder / "a.mat"


def blf(folder: Path) -> Path:
    path = folder / "a.blf"
    with can.BLFWriter(path) as writer:
        writer(can.Message(arbitration_id=1, data=[1], timestamp=1.0))
    packed = deflated()
    size = 32 + len(packed)
    container = struct.pack("<4sHHII", b"LOBJ", 16, 1, size, 10) + struct.pack("<H6xL4x", 2, SIZE % 2**32) + packed
    path.write_bytes(path.read_bytes() + container)
    return path


BOMBS = {
    "parquet of runs": parquet_of_runs,
    "parquet of texts": parquet_of_texts,
    "mcap chunk": ros2(StoragePlugin.MCAP, CompressionMode.STORAGE),
    "bag's message": ros2(StoragePlugin.SQLITE3, CompressionMode.MESSAGE),
    "bag's file": ros2(StoragePlugin.SQLITE3, CompressionMode.FILE),
    "ros1 chunk": ros1,
    "mdf": mdf_packed(SIZE),
    "mdf that lies": mdf_packed(10),
    "mdf of nothing": mdf_of_nothing,
    "matlab": matlab,
    "blf": blf,
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", BOMBS)
def test_a_bomb_is_refused_in_time_and_memory(kind: str, tmp_path: Path) -> None:
    """What a reader holds at once is the file, and at most ALWAYS that was unpacked, twice while it is joined."""
    bomb = BOMBS[kind](tmp_path)
    warm = tmp_path / f"warm{bomb.suffix}"  # loads the libraries
    warm.write_bytes(b"no such format" * 100)
    dbc = tmp_path / "a.dbc"
    dbc.write_text('VERSION ""\n\nBO_ 1 M: 8 X\n SG_ s : 0|8@1+ (1,0) [0|0] "" X\n')
    arguments = [str(bomb), str(warm), str(dbc) if bomb.suffix == ".blf" else ""]
    done = subprocess.run([sys.executable, "-c", READ, *arguments], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    said, seconds, memory = json.loads(done.stdout)
    size = bomb.stat().st_size if bomb.is_file() else sum(one.stat().st_size for one in bomb.iterdir())
    assert "which no recording does: it is not read" in said, said
    assert "\n" not in said
    assert seconds < SECONDS
    assert memory < 2 * ALWAYS + 4 * size


def test_columns_of_parquet_that_hold_no_channel_are_not_read(tmp_path: Path) -> None:
    """Of these a few bytes may be gigabytes, whatever their sizes say."""
    others = {
        "list": pa.array([[1.0] * 9] * 3),
        "record": pa.array([{"a": 1, "b": "x"}] * 3),
        "long text": pa.array(["x"] * 3, pa.large_string()),
        "bytes": pa.array([b"xy"] * 3, pa.binary(2)),
        "variable": pa.array([b"xy"] * 3),
    }
    read = {
        "time_s": pa.array([0.0, 0.1, 0.2]),
        "gear": pa.array([1, 2, 3]),
        "on": pa.array([True] * 3),
        "said": ["a"] * 3,
    }
    pq.write_table(pa.table({**read, **others}), tmp_path / "a.parquet")
    (table,) = read_tables(tmp_path / "a.parquet")
    assert {*table.columns} == {*read}
    assert table.notes[0].endswith("not read: list, record, long text, bytes, variable")


def wide(folder: Path) -> Path:
    """A log of half an hour at 100 Hz whose live columns share the file with 300 that are constant."""
    t = np.arange(180_000) / 100.0
    live = {"time_s": t, "v_x_mps": 15.0 + np.sin(t), "yaw_rate_radps": 0.2 * np.cos(t)}
    pq.write_table(pa.table(live | {f"flag_{i}": np.zeros(len(t)) for i in range(300)}), folder / "a.parquet")
    return folder / "a.parquet"


def test_a_wide_file_of_parquet_is_read_for_what_is_asked_of_it(tmp_path: Path) -> None:
    path = wide(tmp_path)
    assert Budget(path).left < 300 * 180_000 * 8
    recording = read(path)
    assert {*recording.channels} == {"v_x", "yaw_rate"}
    np.testing.assert_allclose(recording.channels["v_x"], 15.0 + np.sin(recording.t), atol=1e-9)
    found = inspect(RecordingFile(path=path))
    assert {*found.channels} == {"v_x", "yaw_rate"}
    assert found.tables[0].beyond[-1] == "flag_299"
    assert "not read, too large together: flag_" in spoken(found)


def test_a_column_of_parquet_counts_once_and_all_of_them_together(tmp_path: Path) -> None:
    (table,) = read_tables(wide(tmp_path))
    for _ in range(200):
        table.numbers("v_x_mps")
    with pytest.raises(InputError, match="which no recording does: it is not read"):
        [table.numbers(name) for name in table.columns]


@pytest.mark.parametrize(
    ("pack", "unpacker"),
    [(zlib.compress, Zlib), (bz2.compress, bz2.BZ2Decompressor), (lz4.compress, lz4.LZ4FrameDecompressor)],
)
def test_what_fits_is_unpacked_whole_and_used_up(tmp_path: Path, pack, unpacker) -> None:
    (tmp_path / "a").write_bytes(b"0123456789")
    content = np.random.default_rng(0).bytes(3_000_000)
    budget = Budget(tmp_path / "a")
    assert budget.left == ALWAYS
    assert budget.unpacked(pack(content), unpacker) == content
    assert budget.left == ALWAYS - len(content)
    budget.count(pack(content), unpacker)
    assert budget.left == ALWAYS - 2 * len(content)
    with pytest.raises(EOFError):
        budget.count(pack(content)[:-9], unpacker)


def test_pieces_one_after_another_are_few(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"")
    budget = Budget(tmp_path / "a")
    assert budget.unpacked(bz2.compress(b"a") + bz2.compress(b"b"), bz2.BZ2Decompressor) == b"ab"
    with pytest.raises(InputError, match="is packed in more than 1000 pieces"):
        budget.count(bz2.compress(b"") * (MOST_FRAMES + 1), bz2.BZ2Decompressor)


def test_a_large_file_may_unpack_to_as_many_times_its_size(tmp_path: Path) -> None:
    with (tmp_path / "a").open("wb") as file:
        file.truncate(ALWAYS)
    assert Budget(tmp_path / "a").left == RATIO * ALWAYS


def test_an_array_that_is_shorter_than_it_says_is_refused(tmp_path: Path) -> None:
    log = tmp_path / "CAN" / "speed"
    log.mkdir(parents=True)
    for name in ("t", "value"):
        np.save(log / f"{name}.npy", np.arange(10.0))
        text = (log / f"{name}.npy").read_bytes()
        (log / name).write_bytes(text.replace(b"(10,), ", b"(900000000000,), "))
    refused(tmp_path, "cannot be read as a numpy array")


def test_columns_that_a_bags_database_computes_are_refused(tmp_path: Path) -> None:
    with sqlite3.connect(tmp_path / "a.db3") as base:
        base.execute("CREATE TABLE messages(id INTEGER, data BLOB GENERATED ALWAYS AS (zeroblob(1000000000)))")
    refused(tmp_path / "a.db3", "is no ROS bag: its database holds computed columns")
