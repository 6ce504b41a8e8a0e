"""Configuration is construction: every `_target_` is held against its signature before anything is computed."""

from _entry.targets import check_targets

import inspect
import pkgutil
import types
import typing
from collections.abc import Mapping

from omegaconf import MISSING

from vehicle_sbi.errors import InputError, unknown

SCALARS: Mapping[type, tuple[str, tuple[type, ...]]] = {
    bool: ("true or false", (bool,)),
    int: ("a whole number", (int,)),
    float: ("a number", (int, float)),
}
"""How each declared type is called, and the types that a value of it may have in YAML."""


def check_construction(node: object, where: str = "") -> None:
    """Check every `_target_` under `node`, a configuration whose references are resolved, at the key `where`.

    Raises InputError for a key that the signature does not have and for a scalar of another type than it declares.
    """
    if isinstance(node, list):
        for i, child in enumerate(node):
            check_construction(child, f"{where}[{i}]")
    if not isinstance(node, dict):
        return
    if "_target_" in node:
        _check_call(node, where)
    for key, child in node.items():
        check_construction(child, f"{where}.{key}" if where else str(key))


def signature(target: object, where: str) -> inspect.Signature:
    """The signature of what `target` names; raises InputError if there is no such thing to call."""
    check_targets({"_target_": target}, where)  # before it is imported
    try:
        called = pkgutil.resolve_name(str(target))
    except (ImportError, AttributeError, ValueError):
        called = None
    if not callable(called):
        raise InputError(f"{where}: cannot import its _target_ '{target}'")
    return inspect.signature(called)


def _check_call(node: Mapping[str, object], where: str) -> None:
    """Raise InputError for a key of `node` that its `_target_` does not take, or takes as another type."""
    parameters = signature(node["_target_"], where).parameters
    takes_any = any(parameter.kind is parameter.VAR_KEYWORD for parameter in parameters.values())
    for key, value in node.items():
        if key in parameters:
            _check_scalar(value, parameters[key].annotation, f"{where}.{key}")
        elif not key.startswith("_") and not takes_any:
            raise unknown("key", key, parameters, f"{where} ({node['_target_']})")


def _check_scalar(value: object, annotation: object, where: str) -> None:
    """Raise InputError for a value of another type where nothing but scalars, or null, is declared."""
    declared = typing.get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
    scalars = [SCALARS[kind] for kind in declared if isinstance(kind, type) and kind in SCALARS]
    optional = types.NoneType in declared
    if len(scalars) + optional < len(declared) or value == MISSING or (value is None and optional):
        return
    if not any(type(value) in accepted for _, accepted in scalars):
        expected = " or ".join([name for name, _ in scalars] + ["null"] * optional)
        raise InputError(f"{where} = {'null' if value is None else value}: must be {expected}")
