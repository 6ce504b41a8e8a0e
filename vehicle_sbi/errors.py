"""The one error a user's mistake raises: a line that says what was given, what is allowed and where it came from."""

import re
from collections.abc import Iterable
from difflib import get_close_matches

LONGEST_WORD, LONGEST = 400, 4000  # characters of a message, of which a file's cells may be megabytes
KEPT = 80  # of a longer word
MOST_LISTED = 50  # known names


class InputError(ValueError):
    """A wrong value at the boundary. Scripts print its single line and exit with status 2."""

    def __init__(self, message: str) -> None:
        words = re.sub(rf"\S{{{LONGEST_WORD},}}", lambda word: f"{word[0][:KEPT]}…", message)
        super().__init__(words if len(words) <= LONGEST else f"{words[:LONGEST]}…")


def unknown(what: str, given: str, known: Iterable[str], where: str) -> InputError:
    """An `InputError` for a name that is not known, listing the known ones, or many of them, with the nearest first."""
    names = list(known)
    nearest = get_close_matches(given, names, n=3, cutoff=0.4)
    listed = nearest + sorted(name for name in names if name not in nearest)
    more = f" and {len(listed) - MOST_LISTED} more" if len(listed) > MOST_LISTED else ""
    return InputError(f"{where}: unknown {what} '{given}'; known: {', '.join(listed[:MOST_LISTED])}{more}")
