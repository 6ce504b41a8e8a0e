"""The folder of a run: named after what was asked for, so that the same command finds its own folder again.

Hydra reads the name as `${study_name:…}`, with the job's overrides.
"""

from _entry.command_line import SUFFIXES, as_typed
from _entry.recordings import warn

import hashlib
import re
import typing
from collections.abc import Mapping, Sequence
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, ListConfig, OmegaConf

from vehicle_sbi.files import sha256
from vehicle_sbi.report.run_folder import RunFolder

FILES = (*SUFFIXES, "recordings", "heldout", "recording.dbc")
"""Keys whose values are files, or lists of them."""

LONGEST_NAME = 120  # characters; file systems allow 255 for a folder


def study_name(overrides: Sequence[str]) -> str:
    """The name of a run's folder: the overrides in sorted order, files by their names.

    Made of characters that need no quotes in a shell or as a value on Hydra's command line. What is cut, or had to be
    replaced, leaves eight digits of a hash of the whole, so that two studies never share a folder.
    """
    if not overrides:
        return "default"
    asked = sorted(as_typed([override.lstrip("+") for override in overrides]))
    exact = "+".join(override.replace("=", "-", 1) for override in asked)
    readable = "+".join(_without_folders(override).replace("=", "-", 1) for override in asked)
    name = re.sub(r"[^\w.+-]+", "_", readable, flags=re.ASCII).strip("_.")
    if name == exact and len(name) <= LONGEST_NAME:
        return name
    return f"{name[:LONGEST_NAME]}-{hashlib.sha256(' '.join(asked).encode()).hexdigest()[:8]}"


def _without_folders(override: str) -> str:
    """An override that names files, without their folders and the brackets of a list; any other as it is."""
    key, equals, value = override.partition("=")
    if key not in FILES:
        return override
    return key + equals + re.sub(r"[^,'\"\[\]]*/(?=[^,'\"\[\]/])", "", value).strip("[]'\" ")


def _study_name_of(overrides: ListConfig) -> str:
    return study_name(typing.cast(list[str], OmegaConf.to_container(overrides, resolve=False)))


OmegaConf.register_new_resolver("study_name", _study_name_of, replace=True)


def run_folder(cfg: DictConfig, *, inputs: Mapping[str, str]) -> RunFolder:
    """The run folder of this job, new or resumed; `inputs` are the SHA-256 of the files that its recordings need."""
    hydra_cfg = HydraConfig.get()
    folder = RunFolder.open(
        Path(hydra_cfg.runtime.output_dir),
        config=typing.cast(dict[str, object], OmegaConf.to_container(cfg, resolve=True)),
        overrides=list(hydra_cfg.overrides.task),
        inputs={**inputs, **_vehicle_file(cfg)},
        choices={str(group): str(choice) for group, choice in hydra_cfg.runtime.choices.items()},
    )
    warn(folder.notices)
    return folder


def _vehicle_file(cfg: DictConfig) -> dict[str, str]:
    """The file that states the vehicle, if one does, with its SHA-256."""
    path = cfg.vehicle.get("path")
    return {} if path is None else {path: sha256(Path(path))}
