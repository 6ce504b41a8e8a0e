"""Configured recordings that do not ship: whose they are, where to get them, and whether they are here."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vehicle_sbi import plain_yaml
from vehicle_sbi.files import sha256

LIST = Path(__file__).resolve().parent.parent / "recordings" / "elsewhere.yaml"


@dataclass(frozen=True, kw_only=True)
class Elsewhere:
    """A source of recordings: the names for `recording=` that use it, its licence, and its files by SHA-256."""

    used_by: Sequence[str]
    licence: str
    source: str
    files: Mapping[str, str]

    def lines(self, folder: Path) -> list[str]:
        """What is said of it, each file beside what is in the folder."""
        found = [
            f"  {state(folder / name, digest)}: {name}\n    sha256 {digest}" for name, digest in self.files.items()
        ]
        return [", ".join(self.used_by), f"  from {self.source}", f"  licence: {self.licence}", *found]


def state(path: Path, digest: str) -> str:
    """Whether a file is there, and the one that is meant."""
    if not path.is_file():
        return "not here"
    return "here" if sha256(path) == digest else "here, but another file"


def listed() -> list[Elsewhere]:
    """Every source, in the order of the list that ships with the package."""
    return [Elsewhere(**one) for one in plain_yaml.load(LIST)]


def knows(path: Path) -> bool:
    """Whether the list says where to get the file that a path should hold."""
    return any(path.as_posix().endswith(f"/{name}") for one in listed() for name in one.files)
