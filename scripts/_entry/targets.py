"""No code from files: a configuration may name the classes that the project's own files name, and no others.

Hydra imports and calls whatever stands at a `_target_`, which an experiment or a recording of somebody else can set to
any function of any module. Targets are therefore compared before anything is imported, in Hydra's own part too.
"""

from _entry import configuration

import functools
import re
from collections.abc import Mapping, Sequence
from typing import Any

from hydra._internal.config_loader_impl import ConfigLoaderImpl
from omegaconf import DictConfig, OmegaConf

from vehicle_sbi.errors import InputError, unknown

PLACES = (r"hydra\._internal\.core_plugins\.\w+", r"hydra_plugins\.\w+\.\w+", r"hydra\.experimental\.callbacks")
PLUGIN = re.compile(rf"({'|'.join(PLACES)})\.[A-Z]\w+")  # of Hydra's own
HANDLERS = {f"logging.{name}" for name in ("StreamHandler", "FileHandler", "NullHandler", "Formatter")}
SHELL = ("env_set", "setup", "additional_parameters")  # what jobs' environments and shells get
FACTORIES = ("_target_", "()", "class")  # what is imported and called, in Hydra's nodes and in those of logging


@functools.cache
def allowed() -> frozenset[str]:
    """Every `_target_` of the project's own configuration."""
    files = sorted(configuration.CONF.rglob("*.yaml"))
    return frozenset(
        target for file in files for target in re.findall(r"_target_: *([\w.]+)", file.read_text(encoding="utf-8"))
    )


def check_targets(node: Any, where: str = "") -> None:
    """Raise InputError for a `_target_` under `node` that the project's configuration does not name itself."""
    for key, value, place in _entries(node, where):
        if key == "_target_" and value not in allowed():
            raise unknown("_target_", str(value), allowed(), where or "configuration")
        check_targets(value, place)


def check_hydra(node: Any, typed: Sequence[str] = (), where: str = "hydra") -> None:
    """Raise InputError for what Hydra, or the logging that it sets up, would call beside its own plugins, and for what
    would reach a shell without being `typed` on the command line."""
    for key, value, place in _entries(node, where):
        shell = key in SHELL or (where.startswith("hydra.launcher") and "\n" in str(value))
        if shell and value and not any(word.lstrip("+").startswith(place) for word in typed):
            raise InputError(f"{place}: what a shell gets is taken from the command line alone, not from a file")
        own = PLUGIN.fullmatch(str(value)) if key == "_target_" else str(value) in HANDLERS
        if key in FACTORIES and not own:
            raise InputError(f"{place} = {value}: only Hydra's own plugins and plain handlers of logging are called")
        check_hydra(value, typed, place)


def guard() -> None:
    """Check every configuration right after Hydra has composed it, before any part of it is instantiated."""
    compose = ConfigLoaderImpl.load_configuration

    @functools.wraps(compose)
    def checked(self: ConfigLoaderImpl, *given: Any, **more: Any) -> DictConfig:
        cfg = compose(self, *given, **more)
        parts: Any = OmegaConf.to_container(cfg, resolve=False)
        own = parts.pop("hydra", None) or {}
        check_hydra(own, own.get("overrides", {}).get("hydra", []))
        check_targets(parts)
        return cfg

    ConfigLoaderImpl.load_configuration = checked


def _entries(node: Any, where: str) -> list[tuple[str, Any, str]]:
    """Key, value and place of everything in a mapping or a list."""
    if isinstance(node, Mapping):
        return [(str(key), value, f"{where}.{key}".lstrip(".")) for key, value in node.items()]
    return [("", value, f"{where}[{i}]") for i, value in enumerate(node)] if isinstance(node, list) else []
