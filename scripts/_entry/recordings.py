"""Recordings by name: a name in `recordings` or `heldout` stands for the settings that conf/recording has of it.

`${shipped:FILE}` in a configuration is a recording that the package brings with it.
"""

from _entry.command_line import is_file
from _entry.targets import check_targets

import sys
import typing
from collections.abc import Iterable
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from vehicle_sbi.command import RECORDINGS
from vehicle_sbi.errors import InputError, unknown

OmegaConf.register_new_resolver("shipped", lambda file: str(RECORDINGS / file), replace=True)


def named_recordings(cfg: DictConfig) -> DictConfig:
    """The configuration with names in `recordings`, and in `heldout` if it has that, replaced by what their
    configuration files have.

    Raises InputError where there is none, for a name that is not there, or one of another vehicle than `recording`'s.
    """
    if not cfg.recordings and OmegaConf.is_missing(cfg.recording, "path"):
        raise InputError("recordings: none is given; recordings=[drive.csv,...], or a name that conf/recording has")
    for where in ("recordings", "heldout"):
        given = cfg.get(where) or []
        entries = [given] if isinstance(given, str) else list(given)
        if entries:
            cfg[where] = [_settings(entry, cfg, where) for entry in entries]
    return cfg


def _settings(entry: object, cfg: DictConfig, where: str) -> object:
    """A file, or settings that are spelled out, as they are; a name's settings: those of the command line where it is
    the recording that is chosen."""
    if isinstance(entry, DictConfig):
        return entry
    entry = str(entry)
    configured, chosen = _configured(), HydraConfig.get().runtime.choices
    if entry not in configured:
        if is_file("recording", entry):
            return entry
        raise unknown("recording", entry, configured, where)
    if entry == chosen["recording"]:
        return OmegaConf.to_container(cfg.recording, resolve=True)
    found = typing.cast(DictConfig, OmegaConf.load(configured[entry]))
    check_targets(OmegaConf.to_container(found), entry)
    vehicle = _vehicle(found)
    if vehicle != chosen["vehicle"]:
        raise InputError(
            f"{where}: {entry} is of vehicle {vehicle}, the others of {chosen['vehicle']}; diagnose one car"
        )
    return OmegaConf.to_container(found.recording, resolve=True)


def _configured() -> dict[str, Path]:
    """Files that `recording=NAME` knows, by name: those of --config-dir before the project's own."""
    sources = [Path(one.path) for one in HydraConfig.get().runtime.config_sources if one.schema == "file"]
    return {file.stem: file for source in reversed(sources) for file in (source / "recording").glob("*.yaml")}


def _vehicle(configuration: DictConfig) -> str | None:
    """The vehicle that a recording's configuration file chooses."""
    defaults = configuration.get("defaults", [])
    return next((entry["override /vehicle"] for entry in defaults if "override /vehicle" in entry), None)


def warn(lines: Iterable[str]) -> None:
    """Print what recordings contradict, as soon as it is known."""
    for line in lines:
        print(f"warning: {line}", file=sys.stderr)
