"""The registry of formats: which reader a file's suffix asks for, and what has to be installed for it.

Nothing here imports a reader before it is needed, so that scripts know the suffixes without numpy.
"""

import importlib
import importlib.util
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from vehicle_sbi.data import elsewhere
from vehicle_sbi.errors import InputError

if TYPE_CHECKING:
    from vehicle_sbi.data.formats.table import Table


@dataclass(frozen=True, kw_only=True)
class Format:
    """How a kind of file is read: `module`.read(path), or read(path, dbc) where it may hold raw CAN frames.

    `extra` is the optional extra of this package that installs the libraries which are imported as `needs`.
    """

    name: str
    module: str
    extra: str | None = None
    needs: tuple[str, ...] = ()
    takes_dbc: bool = False

    def check_installed(self, path: Path) -> None:
        """Raise InputError, with the command that installs them, if libraries are missing."""
        missing = [name for name in self.needs if importlib.util.find_spec(name) is None]
        if missing:
            raise InputError(
                f"{path}: reading {self.name} needs {', '.join(missing)}, which is not installed: "
                f"pip install 'vehicle_sbi[{self.extra}]'"
            )

    def read(self, path: Path, dbc: Path | None) -> "tuple[Table, ...]":
        """The file's tables; InputError if libraries are missing or a database is given where there is no CAN."""
        self.check_installed(path)
        if dbc is not None and not self.takes_dbc:
            raise InputError(f"{path}: a dbc is for raw CAN frames, which {self.name} does not hold")
        reader = importlib.import_module(f"vehicle_sbi.data.formats.{self.module}")
        return reader.read(path, dbc) if self.takes_dbc else reader.read(path)


TEXT = Format(name="text with a header line", module="text")
PARQUET = Format(name="Parquet", module="parquet")
VBO = Format(name="Racelogic VBO", module="vbo")
MATLAB = Format(name="MATLAB", module="matlab")
ROS = Format(name="a ROS bag", module="rosbag", extra="ros", needs=("rosbags",))
MDF = Format(name="MDF4", module="mdf", extra="mdf", needs=("asammdf",), takes_dbc=True)
CAN = Format(name="raw CAN", module="can_log", extra="can", needs=("can", "cantools"), takes_dbc=True)
COMMA2K19 = Format(name="comma2k19", module="comma2k19")

FORMATS: Mapping[str, Format] = MappingProxyType(
    {
        **{".csv": TEXT, ".txt": TEXT, ".parquet": PARQUET, ".vbo": VBO, ".mat": MATLAB},
        **{".mcap": ROS, ".db3": ROS, ".bag": ROS},
        **{".mf4": MDF, ".mdf": MDF, ".blf": CAN, ".asc": CAN},
    }
)
"""What reads a file, by its suffix."""


def read_tables(path: str | Path, dbc: str | Path | None = None) -> "tuple[Table, ...]":
    """The tables of a file or a bag's folder, one a clock; `dbc` says what raw CAN frames mean.

    Raises InputError, in one line, if there is no such file, or none that its suffix promises.
    """
    path = Path(path)
    database = None if dbc is None else Path(dbc)
    if database is not None and not database.is_file():
        raise InputError(f"{database}: no such file")
    return format_of(path).read(path, database)


def _where_from(path: Path) -> str:
    """What helps where a configured recording is not here."""
    return "; vehicle-sbi recordings says where to get it" if elsewhere.knows(path) else ""


def format_of(path: Path) -> Format:
    """How a path is read; InputError if there is no such file, or one of a suffix that no reader knows."""
    if path.is_dir():
        return _format_of_folder(path)
    known = path.suffix.lower() in FORMATS
    if not path.is_file() and (known or not path.suffix):
        raise InputError(f"{path}: {'is no file' if path.exists() else 'no such file'}{_where_from(path)}")
    if not known:
        raise InputError(
            f"{path}: files ending in '{path.suffix}' are not read; those that are: {', '.join(FORMATS)}, "
            "and folders of rosbag2 or comma2k19"
        )
    return FORMATS[path.suffix.lower()]


def _format_of_folder(path: Path) -> Format:
    if (path / "metadata.yaml").is_file():
        return ROS
    if (path / "CAN").is_dir() or (path / "IMU").is_dir():
        return COMMA2K19
    bags = sorted(one.name for one in path.iterdir() if one.suffix.lower() in (".mcap", ".db3"))
    inside = f"; it holds {bags[0]}: name that file" if len(bags) == 1 else ""
    raise InputError(
        f"{path}: is no file, nor a folder of rosbag2 (with metadata.yaml) or of comma2k19 (with CAN/ and IMU/){inside}"
    )
