"""What a stage of a run found, as a file that is nothing but data: to read it runs no code, whoever wrote it.

A stage is a tree of dataclasses, containers, arrays and plain values. Its file is an .npz archive of the arrays, with
the rest as a JSON text in the member `tree`:

    {"version": …, "nodes": [[kind, contents], …], "root": value}

A value is plain, a numpy scalar as {type: number}, or a node by its place, [place]; nodes refer to those before them
alone. What occurs several times is one node, so that it is one object again. Which dataclasses there may be follows
from the type that the reader expects, and never from the file.
"""

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, BinaryIO, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from jaxtyping import AbstractArray

from vehicle_sbi.errors import InputError

FORMAT = 1
PLAIN = (NoneType, bool, int, float, str)
SCALARS = {np.dtype(code).str for code in "?bBhHiIlLefd"}
Result = TypeVar("Result")
Node = tuple[str, Any]


class StageFileError(InputError):
    """A file that is damaged, foreign or of another version."""


def write(file: BinaryIO, result: Result, kind: type[Result]) -> None:
    """Write a stage's result, of the type `kind`.

    TypeError with the place in the tree for what is no data, or a dataclass that `kind` has no place for.
    """
    known = dataclasses_in(kind)
    flat = _Flat({one: name for name, one in known.items()})
    root = flat.value(result, "")
    tree = json.dumps({"version": _version(known), "nodes": flat.nodes, "root": root}, separators=(",", ":"))
    members: dict[str, Any] = {"tree": np.frombuffer(tree.encode(), np.uint8), **flat.arrays}
    np.savez(file, **members)  # noise does not compress


def read(path: Path, kind: type[Result]) -> Result:
    """A stage's result, every object where `kind` has one of its type; StageFileError for any other file."""
    known = dataclasses_in(kind)
    try:
        with np.load(path, allow_pickle=False) as archive:
            tree = json.loads(archive["tree"].tobytes())
            if tree["version"] != _version(known):
                raise ValueError("of another version")
            return _built(tree, archive, known, kind)
    except Exception as error:  # what anyone may have written can be wrong in any way
        raise StageFileError(f"{path}: no stage that can be used ({type(error).__name__}: {error})") from error


def dataclasses_in(kind: Any) -> dict[str, type]:
    """Every dataclass that a value of a type may consist of, by its qualified name."""
    found: dict[str, type] = {}
    left = [kind]
    while left:
        hint = left.pop()
        left += get_args(hint)
        if isinstance(hint, type) and is_dataclass(hint) and _name(hint) not in found:
            found[_name(hint)] = hint
            left += _hints(hint).values()
    return found


def _name(kind: type) -> str:
    return f"{kind.__module__}.{kind.__qualname__}"


def _hints(kind: type) -> dict[str, Any]:
    """Types of what a dataclass is constructed from; what it works out itself is not stored."""
    hints = get_type_hints(kind)
    return {one.name: hints[one.name] for one in fields(kind) if one.init}


def _version(known: Mapping[str, type]) -> str:
    """Of the format and of what dataclasses are made of: other fields mean another version."""
    made_of = {name: [*_hints(kind)] for name, kind in sorted(known.items())}
    return hashlib.sha256(json.dumps([FORMAT, made_of]).encode()).hexdigest()


@dataclass(frozen=True)
class _Flat:
    """A tree laid out as nodes and arrays; `places` are those of objects by their identity."""

    names: Mapping[type, str]
    nodes: list[Node] = field(default_factory=list)
    arrays: dict[str, np.ndarray] = field(default_factory=dict)
    places: dict[int, int] = field(default_factory=dict)

    def value(self, given: object, where: str) -> object:
        """The value as JSON has it, its node added if it is new."""
        if type(given) in PLAIN:
            return given
        if isinstance(given, np.generic) and given.dtype.str in SCALARS:
            return {given.dtype.str: given.item()}
        if id(given) not in self.places:
            node = self._node(given, where)
            self.places[id(given)] = len(self.nodes)
            self.nodes.append(node)
        return [self.places[id(given)]]

    def _node(self, given: Any, where: str) -> Node:
        kind = type(given)
        if kind in (np.ndarray, np.void) and not given.dtype.hasobject:
            name = f"array_{len(self.arrays)}"
            self.arrays[name] = np.asarray(given)
            return "array" if kind is np.ndarray else "record", name
        if kind in (list, tuple):
            return kind.__name__, [self.value(one, f"{where}[{k}]") for k, one in enumerate(given)]
        if kind is dict:
            keyed = [(self.value(key, f"a key of {where}"), key, one) for key, one in given.items()]
            return "dict", [(key, self.value(one, f"{where}[{said!s:.60}]")) for key, said, one in keyed]
        if kind in self.names:
            parts = {name: self.value(getattr(given, name), f"{where}.{name}") for name in _hints(kind)}
            return self.names[kind], parts
        raise TypeError(f"{where or 'the result'} is a {_name(kind)}, which cannot be stored as data")


def _built(tree: Mapping[str, Any], arrays: Mapping[str, np.ndarray], known: Mapping[str, type], kind: Any) -> Any:
    """What a tree describes, if it is of the type `kind`."""
    done: list[Any] = []
    hints = {name: _hints(one) for name, one in known.items()}

    def value(given: Any) -> Any:
        if type(given) in PLAIN:
            return given
        if isinstance(given, dict):
            ((name, number),) = given.items()
            if name not in SCALARS:
                raise ValueError(f"{name} is no kind of number")
            return np.dtype(name).type(number)
        (place,) = given
        return done[place]

    for name, held in tree["nodes"]:
        if name in ("array", "record"):
            done.append(arrays[held] if name == "array" else arrays[held][()])
        elif name in ("list", "tuple"):
            parts = [value(one) for one in held]
            done.append(parts if name == "list" else tuple(parts))
        elif name == "dict":
            done.append({value(key): value(one) for key, one in held})
        else:
            filled = {key: _checked(value(one), hints[name][key]) for key, one in held.items()}
            done.append(known[name](**filled))
    return _checked(value(tree["root"]), kind)


def _checked(value: Any, hint: Any) -> Any:
    """The value; ValueError if it is not of the type."""
    if not _is(value, hint):
        raise ValueError(f"a {_name(type(value))} where there has to be {hint}")
    return value


def _is(value: Any, hint: Any) -> bool:
    """Whether a value is of a type, as far as that goes: no shapes, and numpy's numbers for Python's.

    Fields of dataclasses are checked when those are built.
    """
    kind, of = get_origin(hint) or hint, get_args(hint)
    if kind in (Union, UnionType):
        return any(_is(value, one) for one in of)
    if kind is tuple and of[-1:] != (...,):
        return isinstance(value, tuple) and len(value) == len(of) and all(map(_is, value, of))
    if kind is Any or not isinstance(kind, type):
        return True
    if issubclass(kind, AbstractArray):
        return isinstance(value, np.ndarray)
    if issubclass(kind, float | int):
        return isinstance(value, (kind, np.number, *((int,) if kind is float else ())))
    if not of:
        return isinstance(value, kind)
    if issubclass(kind, Mapping):
        return isinstance(value, kind) and all(_is(key, of[0]) and _is(one, of[1]) for key, one in value.items())
    return isinstance(value, kind) and (not issubclass(kind, Sequence) or all(_is(one, of[0]) for one in value))
