"""extended.yaml: the extended model of a diagnosis as an experiment of scripts/run.py, complete in itself.

Hydra merges an experiment into what run.py starts from. Of the groups that are stated here nothing of that remains, so
that the model is the diagnosed one whatever the defaults are.
"""

import os
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.effects import CATALOGUE

STATED = ("vehicle", "prior", "recording", "noise")
FILES = ("path", "mapping", "dbc")  # keys whose text is a path
HEAD = """\
# @package _global_
# The extended model of a diagnosis. To infer it, with the folder of this file in the place of FOLDER:
#   vehicle-sbi run --config-dir FOLDER experiment=../extended hydra.run.dir=FOLDER-extended
"""


def command(folder: Path) -> str:
    """What infers the extended model of a diagnosis in `folder`."""
    beside = folder.with_name(f"{folder.name}-extended")
    return shlex.join(
        ["vehicle-sbi", "run", "--config-dir", str(folder), "experiment=../extended", f"hydra.run.dir={beside}"]
    )


def extended(model: Model, config: Mapping[str, Any]) -> str:
    """The experiment that infers a model from the recordings that the diagnosis was configured to fit, its parameters
    free in the boxes that were searched."""
    recordings = [_settings(one, config["recording"]) for one in config["recordings"] or [config["recording"]]]
    windows, effects = model.fit.simulator.windows, [*config["effects"], *model.effects]
    stated = {
        "effects": effects,
        "prior": _prior(model.fit.simulator.space, effects),
        "model": config["model"],
        "drive": config["drive"],
        "vehicle": _from_anywhere(config["vehicle"]),
        "recording": recordings[0],
        "recordings": recordings if len(recordings) > 1 else [],
        "window_s": windows.t.shape[1] / windows.rate,
        "warmup_s": config["warmup_s"],
        "noise": config["noise"],
    }
    defaults = "".join(f"  - override /{group}: null\n" for group in STATED)
    content = yaml.dump(stated, Dumper=_Lines, sort_keys=False, width=120)
    return f"{HEAD}defaults:\n{defaults}\n{content}"


class _Lines(yaml.SafeDumper):
    """Writes a list on a line."""


_Lines.add_representer(list, lambda dumper, of: dumper.represent_sequence("tag:yaml.org,2002:seq", of, flow_style=True))


def _settings(one: str | Mapping[str, Any], shared: Mapping[str, Any]) -> dict[str, Any]:
    """How a recording is read: as it says itself, or, of a path, as all are."""
    return _from_anywhere({**shared, "path": one, "name": None} if isinstance(one, str) else one)


def _from_anywhere(node: Any) -> Any:
    """A part of a configuration with its paths made absolute."""
    if isinstance(node, list):
        return [_from_anywhere(one) for one in node]
    if not isinstance(node, Mapping):
        return node
    return {key: _absolute(value) if key in FILES else _from_anywhere(value) for key, value in node.items()}


def _absolute(value: Any) -> Any:
    """A path made absolute; what is in the place of one (a mapping spelled out, or none) stays."""
    return os.path.abspath(value) if isinstance(value, str) else _from_anywhere(value)


def _prior(space: ParameterSpace, effects: Sequence[str]) -> dict[str, Any]:
    """The boxes of what is free, nested as in a prior file; null for what effects have beside that."""
    boxes: dict[str, Any] = {p.name: [float(p.low), float(p.high)] for p in space.parameters}
    held = {p.name: None for name in effects for p in CATALOGUE[name].parameters if p.name not in boxes}
    prior: dict[str, Any] = {}
    for name, box in (boxes | held).items():
        effect, _, parameter = name.rpartition(".")
        (prior.setdefault(effect, {}) if effect else prior)[parameter] = box
    return prior
