"""The one error a user's mistake raises: a line that says what was given, what is allowed and where it came from."""

from collections.abc import Iterable
from difflib import get_close_matches


class InputError(ValueError):
    """A wrong value at the boundary. Scripts print its single line and exit with status 2."""


def unknown(what: str, given: str, known: Iterable[str], where: str) -> InputError:
    """An `InputError` for a name that is not known, listing the known ones with the nearest first."""
    names = list(known)
    nearest = get_close_matches(given, names, n=3, cutoff=0.4)
    listed = nearest + sorted(name for name in names if name not in nearest)
    return InputError(f"{where}: unknown {what} '{given}'; known: {', '.join(listed)}")
