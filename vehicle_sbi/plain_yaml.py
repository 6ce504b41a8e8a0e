"""YAML from anyone: plain data of bounded size, whatever the file holds.

A file of a kilobyte can stand for 10^9 values through aliases of aliases, or nest deeper than Python can follow. Both
are counted on the parser's events, before anything is built of them.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import yaml

LONGEST = 1_000_000  # characters of a file
MOST = 100_000  # values of a file, with aliases written out
DEEPEST = 50  # levels of lists and mappings
DIGITS = 40  # of a number; a double has 17
NUMBERS = ("tag:yaml.org,2002:int", "tag:yaml.org,2002:float")
_RESOLVER = yaml.resolver.Resolver()


class UnreadableYaml(ValueError):
    """A file that is no YAML, or more than a configuration can be; the message is a short line without its name."""


def load(file: Path) -> Any:
    """The plain data of a file; raises OSError if it cannot be read and UnreadableYaml for what is in it."""
    check(file)
    try:
        return yaml.safe_load(file.read_text(encoding="utf-8"))
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise UnreadableYaml(_reason(error)) from None


def check(file: Path) -> None:
    """Raise UnreadableYaml if a file's size, depth or numbers are beyond those of any configuration."""
    if file.stat().st_size > LONGEST:
        raise UnreadableYaml(f"longer than {LONGEST:,} characters")
    try:
        values = sum(_values(file.read_text(encoding="utf-8")))
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise UnreadableYaml(_reason(error)) from None
    if values > MOST:
        raise UnreadableYaml(f"more than {MOST:,} values")


def _values(text: str) -> Iterator[int]:
    """The number of values of each document, with aliases written out."""
    sizes: dict[str | None, int] = {}
    open_nodes: list[tuple[str | None, int]] = [(None, 0)]
    for event in yaml.parse(text, yaml.SafeLoader):
        if isinstance(event, yaml.CollectionStartEvent):
            open_nodes.append((event.anchor, 1))
            if len(open_nodes) > DEEPEST:
                raise UnreadableYaml(f"nested deeper than {DEEPEST} levels")
            continue
        if isinstance(event, yaml.CollectionEndEvent):
            anchor, size = open_nodes.pop()
            sizes[anchor] = size
        elif isinstance(event, yaml.AliasEvent):
            size = sizes.get(event.anchor, 1)
        elif isinstance(event, yaml.ScalarEvent):
            size = sizes[event.anchor] = 1
            _check_number(event)
        else:
            continue
        outer, so_far = open_nodes[-1]
        open_nodes[-1] = outer, min(so_far + size, MOST + 1)
    yield open_nodes[0][1]


def _check_number(scalar: yaml.ScalarEvent) -> None:
    """Refuse a long number in any of YAML's notations: decimal, hexadecimal, octal, binary, to the base of 60."""
    if len(scalar.value) <= DIGITS:
        return
    tag = scalar.tag or _RESOLVER.resolve(yaml.ScalarNode, scalar.value, scalar.implicit)
    if tag in NUMBERS:
        raise UnreadableYaml(f"line {scalar.start_mark.line + 1}: a number of more than {DIGITS} digits")


def _reason(error: Exception) -> str:
    """Why a text is no YAML, and where."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    place = f", line {mark.line + 1}" if mark else ""
    said = getattr(error, "problem", None) or getattr(error, "context", None) or str(error).partition("\n")[0]
    return f"not valid YAML{place}: {said}"
