"""What a recording holds, a guessed mapping, and what looks wrong; writes a mapping and a vehicle file to edit.

python scripts/inspect_recording.py recording=drive.csv
"""

from _entry import launch  # first: it sets the number of threads

import os
from pathlib import Path

from hydra.utils import instantiate
from omegaconf import DictConfig

from vehicle_sbi.data.inspection.spoken import next_command, spoken
from vehicle_sbi.data.inspection.written import write


@launch("inspect_recording")
def main(cfg: DictConfig) -> None:
    inspection = instantiate(cfg.inspection)
    print(spoken(inspection), end="\n\n")
    if not inspection.given:
        mapping, vehicle = write(inspection, Path(cfg.to), overwrite=cfg.overwrite)
        command = "vehicle-sbi diagnose" if "VEHICLE_SBI_COMMAND" in os.environ else "python scripts/diagnose.py"
        print(f"written: {mapping}, {vehicle}; edit both, then")
        print(f"  {next_command(inspection, mapping, vehicle, command=command)}")


if __name__ == "__main__":
    main()
