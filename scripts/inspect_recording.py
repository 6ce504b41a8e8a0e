"""What a recording holds, a guessed mapping, and what looks wrong; writes a mapping and a vehicle file to edit.

python scripts/inspect_recording.py recording=drive.csv
python scripts/inspect_recording.py recording=drive.mcap mapping=autoware
"""

from _entry import launch  # first: it sets the number of threads

import os
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from hydra.utils import instantiate
from omegaconf import DictConfig, OmegaConf

from vehicle_sbi.command import CONF, as_typed
from vehicle_sbi.data.inspection.inspection import Inspection
from vehicle_sbi.data.inspection.presets import fitting
from vehicle_sbi.data.inspection.spoken import next_command, spoken
from vehicle_sbi.data.inspection.written import write, write_vehicle
from vehicle_sbi.errors import InputError


@launch("inspect_recording")
def main(cfg: DictConfig) -> None:
    inspection = instantiate(cfg.inspection)
    print(spoken(inspection), end="\n\n")
    if inspection.given and inspection.unread:
        raise InputError(inspection.unread)
    own = vehicle_given(cfg)
    if not inspection.given:
        for preset in fitting(inspection.tables, CONF / "mapping"):
            print(f"mapping={preset}, a preset, has columns of this file: add it to this command, to check the file\n")
        mapping, vehicle = write(inspection, Path(cfg.to), vehicle=own, overwrite=cfg.overwrite)
        written = f"{mapping}, {vehicle}; edit both" if own is None else f"{mapping}; edit it"
        say_next(inspection, mapping, vehicle, f"written: {written}")
    elif (given := mapping_given(cfg)) is None:
        return
    elif own is not None:
        say_next(inspection, given, own, "nothing to write")
    else:
        vehicle, written = write_vehicle(inspection, Path(cfg.to))
        say_next(inspection, given, vehicle, f"{'written' if written else 'there already'}: {vehicle}; edit it")


def mapping_given(cfg: DictConfig) -> str | None:
    """The mapping as the user named it; None where a configured recording brings its own, and its vehicle."""
    choices = HydraConfig.get().runtime.choices
    if choices["recording"] != "file":
        return None
    return cfg.recording.mapping if isinstance(cfg.recording.mapping, str) else choices["mapping"]


def vehicle_given(cfg: DictConfig) -> Path | None:
    """The vehicle file that the user named."""
    chosen = HydraConfig.get().runtime.choices["vehicle"] == "file"
    return Path(cfg.vehicle.path) if chosen and not OmegaConf.is_missing(cfg.vehicle, "path") else None


def say_next(inspection: Inspection, mapping: Path | str, vehicle: Path, done: str) -> None:
    """What was written, and what to type next for either answer."""
    print(f"{done}, then for parameters, or for what a simulation lacks")
    for verb in ("run", "diagnose"):
        line = next_command(inspection, mapping, vehicle, command=f"python scripts/{verb}.py")
        print(f"  {as_typed(verb, line) if 'VEHICLE_SBI_COMMAND' in os.environ else line}")


if __name__ == "__main__":
    main()
