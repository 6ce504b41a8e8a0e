"""Texts between single quotes, as Hydra's grammar of overrides reads them whatever they hold.

A backslash is itself there, unless it stands before a quote or at the end: then each is written twice, and a quote
inside has one more before it.
"""

import re

QUOTED = r"'(?:[^'\\]|\\.)*'|\"(?:[^\"\\]|\\.)*\""
"""A text between quotes of either kind."""


def quoted(text: str) -> str:
    """The text between single quotes."""
    inside = re.sub(r"(\\*)('|\Z)", lambda found: 2 * found[1] + ("\\'" if found[2] else ""), text)
    return f"'{inside}'"


def unquoted(value: str) -> str:
    """The text between quotes of either kind, the inverse of `quoted`; any other value as it is."""
    if not re.fullmatch(QUOTED, value, flags=re.DOTALL):
        return value
    mark, inside = value[0], value[1:-1]
    return re.sub(rf"(\\+)({mark}|\Z)", lambda found: len(found[1]) // 2 * "\\" + found[2], inside)
