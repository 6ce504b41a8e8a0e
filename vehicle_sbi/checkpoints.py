"""Files that a run goes on from, used again only as this run left them.

Each is bound by its SHA-256 to the run that wrote it. What is damaged, missing or of somebody else is made anew, and so
is everything that was made after it, since it may rest on it.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import BinaryIO

from vehicle_sbi.files import sha256, write_atomically


@dataclass(frozen=True)
class Checkpoints:
    """Files under `folder`, and the SHA-256 of each by name, in the order in which they were made.

    `changed` is called after every change of `sealed`, for whoever stores it.
    """

    folder: Path
    sealed: dict[str, str] = field(default_factory=dict)
    changed: Callable[[], object] = lambda: None

    @classmethod
    def as_found(cls, folder: Path) -> "Checkpoints":
        """Those of a folder that nobody else writes, taken as they are."""
        names = [path.relative_to(folder).as_posix() for path in sorted(folder.rglob("*")) if path.is_file()]
        return cls(folder, {name: sha256(folder / name) for name in names})

    def kept(self, name: str) -> Path | None:
        """The file, if it is there as it was left."""
        path = self.folder / name
        intact = name in self.sealed and path.is_file() and sha256(path) == self.sealed[name]
        return path if intact else None

    def write(self, name: str, write: Callable[[BinaryIO], object]) -> Path:
        """Write a file whole; those that were made after an earlier one of its name no longer count."""
        self._forget_from(name)
        write_atomically(self.folder / name, write)
        return self.seal(name)

    def seal(self, name: str) -> Path:
        """Bind a file to this run as it is now."""
        self.sealed[name] = sha256(self.folder / name)
        self.changed()
        return self.folder / name

    def _forget_from(self, name: str) -> None:
        names = [*self.sealed]
        for later in names[names.index(name) :] if name in self.sealed else []:
            del self.sealed[later]
        self.changed()
