"""ROS bags, through `rosbags`: rosbag2 (sqlite3 or MCAP, a file or its folder) and ROS 1. A table a topic.

Columns are called `/topic.field`, nested fields `/topic.twist.linear.x`, elements of short arrays `/topic.field.0`.
Time [s] runs from the first message of the bag. It is the message's own stamp where most of the topic's belong to the
bag's time, else the time at which the bag received the message; the difference of the two is noted.
"""

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np
from rosbags.interfaces import Connection, MessageDefinitionFormat, Nodetype
from rosbags.rosbag1 import Reader as Reader1
from rosbags.rosbag2 import Reader as Reader2
from rosbags.typesys import Stores, get_types_from_idl, get_types_from_msg, get_typestore

from vehicle_sbi.data.formats.limits import Budget
from vehicle_sbi.data.formats.ros_definitions import DEFINITIONS
from vehicle_sbi.data.formats.ros_messages import Definitions, UnreadableMessageError, numbers
from vehicle_sbi.data.formats.ros_unpacking import bounded
from vehicle_sbi.data.formats.table import Table, foreign, one_line
from vehicle_sbi.errors import InputError

LARGEST_MESSAGE = 16384  # [bytes]; images and point clouds are larger
MOST_NAMED = 8  # topics that cannot be read; the rest is counted
LONGEST_DELAY_S = 10.0  # between a message's stamp and its reception, beyond which the stamp is of another clock
STAMPS = ("header.stamp", "stamp")
COMPUTED = "SELECT count(*) FROM sqlite_master AS one, pragma_table_xinfo(one.name) AS it WHERE it.hidden > 0"
BULK = ("uint8", "int8", "byte", "char", "octet")

UNITS: Mapping[str, tuple[str, ...]] = {
    "m/s": ("linear.x", "linear.y", "linear.z", "longitudinal_velocity", "lateral_velocity", "speed", "velocity"),
    "rad/s": (
        "angular.x", "angular.y", "angular.z", "angular_velocity.x", "angular_velocity.y", "angular_velocity.z",
        "heading_rate", "steering_angle_velocity", "steering_tire_rotation_rate",
    ),
    "m/s²": ("linear_acceleration.x", "linear_acceleration.y", "linear_acceleration.z"),
    "rad": ("steering_tire_angle", "steering_angle"),
}  # fmt: skip
"""Units of fields by the ends of their names: ROS has SI throughout (REP 103), and no field states its own."""


@dataclass
class Topic:
    """What a bag holds of one topic: reception times [ns] and the bytes of its messages."""

    connection: Connection
    received: list[int] = field(default_factory=list)
    raws: list[bytes] = field(default_factory=list)
    too_large: int = 0


def read(path: Path) -> tuple[Table, ...]:
    """A table a topic that holds numbers; InputError if the bag is damaged or has none."""
    _check_storage(path)
    ros2, budget = path.suffix.lower() != ".bag", Budget(path)
    with foreign(path, "a ROS bag"), bounded(budget), _opened(path) as reader:
        definitions = _definitions(reader.connections, ros2=ros2)
        topics = _topics(reader, definitions, budget)
    start = min((topic.received[0] for topic in topics if topic.received), default=0)
    left_out: list[str] = []
    tables = [table for topic in topics if (table := _table(path, topic, definitions, start, left_out, ros2=ros2))]
    if not tables:
        raise InputError(f"{path}: no topic with numbers in it; left out: {', '.join(left_out) or 'nothing'}")
    return tuple(replace(table, notes=(*table.notes, *_unread(left_out))) for table in tables)


def _unread(topics: Sequence[str]) -> list[str]:
    """What is said of topics that cannot be read, whichever topic is used."""
    more = f" and {len(topics) - MOST_NAMED} more" if len(topics) > MOST_NAMED else ""
    return [f"topics that cannot be read: {', '.join(topics[:MOST_NAMED])}{more}"] if topics else []


@contextmanager
def _opened(path: Path) -> Iterator[Reader1 | Reader2]:
    with Reader1(path) if path.suffix.lower() == ".bag" else Reader2(path) as reader:
        yield reader


def _check_storage(path: Path) -> None:
    """Raise InputError for what `rosbags` would run into: an empty file, and databases that are more than tables."""
    files = [path] if path.is_file() else sorted(path.glob("*.db3"))
    for file in files:
        if file.stat().st_size == 0:
            raise InputError(f"{file}: is empty")
        if file.suffix.lower() != ".db3":
            continue
        if set(str(file)) & set("?#%"):
            raise InputError(f"{file}: a sqlite3 bag cannot be read from a path with ?, # or %: rename it")
        with foreign(file, "a ROS bag"), closing(sqlite3.connect(f"file:{quote(str(file))}?mode=ro", uri=True)) as base:
            kinds = {kind for (kind,) in base.execute("SELECT DISTINCT type FROM sqlite_master")}
            if base.execute(COMPUTED).fetchone()[0]:
                kinds.add("computed columns")
        if kinds - {"table", "index"}:
            raise InputError(f"{file}: is no ROS bag: its database holds {', '.join(sorted(kinds))}")


def _definitions(connections: Sequence[Connection], *, ros2: bool) -> Definitions:
    """Types as the bag defines them, those of ROS and of `ros_definitions` where it does not."""
    known: dict[str, Any] = dict(get_typestore(Stores.ROS2_HUMBLE if ros2 else Stores.ROS1_NOETIC).fielddefs)
    for name, text in DEFINITIONS.items():
        known |= get_types_from_msg(text, name)
    for connection in connections:
        text = connection.msgdef.data
        if connection.msgdef.format == MessageDefinitionFormat.MSG:
            known |= get_types_from_msg(text, connection.msgtype)
        elif connection.msgdef.format == MessageDefinitionFormat.IDL:
            for part in text.split("=" * 80 + "\n") if text.startswith("=" * 80) else [text]:
                known |= get_types_from_idl(part.partition("\n")[2] if part.startswith("IDL: ") else part)
    return known


def _topics(reader: Reader1 | Reader2, definitions: Definitions, budget: Budget) -> list[Topic]:
    """The messages of every topic that is not images, point clouds or texts.

    An index may lead to one chunk many times, so what is kept counts too.
    """
    wanted = [one for one in reader.connections if not _is_bulk(one.msgtype, definitions, 0)]
    topics: dict[str, Topic] = {}
    for one in wanted:
        topics.setdefault(one.topic, Topic(connection=one))
    if not wanted:
        return []
    for connection, received, raw in reader.messages(wanted):  # pyright: ignore[reportArgumentType]
        topic = topics[connection.topic]
        if connection.msgtype != topic.connection.msgtype:
            continue
        if len(raw) > LARGEST_MESSAGE:
            topic.too_large += 1
            continue
        budget.take(len(raw))
        topic.received.append(received)
        topic.raws.append(bytes(raw))
    return [topic for topic in topics.values() if topic.raws]


def _is_bulk(typename: str, definitions: Definitions, depth: int) -> bool:
    """Whether messages of a type carry raw bytes, as images and point clouds do."""
    if depth > 8 or typename not in definitions:
        return False
    for _, (node, content) in definitions[typename][1]:
        element = content[0] if node in (Nodetype.ARRAY, Nodetype.SEQUENCE) else (node, content)
        if node == Nodetype.SEQUENCE and element[0] == Nodetype.BASE and element[1][0] in BULK:
            return True
        if element[0] == Nodetype.NAME and _is_bulk(element[1], definitions, depth + 1):
            return True
    return False


def _table(
    path: Path, topic: Topic, definitions: Definitions, start: int, left_out: list[str], *, ros2: bool
) -> Table | None:
    """The topic's numbers on its clock, None (and a word in `left_out`) if they cannot be read."""
    name = one_line(topic.connection.topic)
    try:
        columns = numbers(topic.raws, topic.connection.msgtype, definitions, cdr=ros2)
    except UnreadableMessageError as error:
        left_out.append(f"{name} ({one_line(error)})")
        return None
    t, notes, timed = _clock(name, columns, np.array(topic.received, dtype=np.int64), start)
    kept = {
        f"{name}.{key}": values
        for key, values in columns.items()
        if "covariance" not in key and not key.endswith((".sec", ".nanosec"))
    }
    if not kept:
        return None
    order = np.argsort(t, kind="stable")
    order = order[timed[order]]
    if np.any(np.diff(order) < 0):
        notes = (*notes, f"{name}: messages put in the order of their time")
    if topic.too_large:
        notes = (*notes, f"{name}: {topic.too_large} messages above {LARGEST_MESSAGE} bytes left out")
    return Table(
        path=path,
        columns={"t": t[order], **{key: values[order] for key, values in kept.items()}},
        time="t",
        clock=name,
        units={"t": "s", **_units(kept)},
        notes=notes,
    )


def _clock(
    name: str, columns: Mapping[str, np.ndarray], received: np.ndarray, start: int
) -> tuple[np.ndarray, tuple[str, ...], np.ndarray]:
    """Times [s] since the start [ns] of the bag, notes of which clock they are, and which messages have a time.

    Most messages decide whether stamps are of the bag's clock; the few whose stamp is not set have no time then.
    """
    stamp = next((one for one in STAMPS if f"{one}.sec" in columns and f"{one}.nanosec" in columns), None)
    by_reception, every = (received - start) / 1e9, np.ones(len(received), dtype=bool)
    if stamp is None:
        return by_reception, (f"{name}: its time is the bag's reception; its messages have no stamp",), every
    stamped = columns[f"{stamp}.sec"] * 1_000_000_000 + columns[f"{stamp}.nanosec"]
    late = (received - stamped) / 1e9
    near = np.abs(late) <= LONGEST_DELAY_S
    usual = float(np.median(np.abs(late)))
    if usual > LONGEST_DELAY_S:
        why = f"{name}: its time is the bag's reception, as {stamp} lies {usual:.3g} s from it in the median"
        return by_reception, (why,), every
    spread = f"{late[near].min():.2g} to {late[near].max():.2g} s"
    notes = [f"{name}: its time is {stamp}; the bag received it {np.median(late[near]):.2g} s later ({spread})"]
    if not near.all():
        off = f"{(~near).sum()} of {len(near)} messages left out"
        notes.append(f"{name}: {off}: their {stamp} lies more than {LONGEST_DELAY_S:g} s from their reception")
    return (stamped - start) / 1e9, tuple(notes), near


def _units(columns: Mapping[str, np.ndarray]) -> dict[str, str]:
    """The units of fields whose names every ROS message uses alike."""
    return {
        column: unit
        for column in columns
        for unit, ends in UNITS.items()
        if column.endswith(tuple(f".{end}" for end in ends)) and ".accel." not in column
    }
