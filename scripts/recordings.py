"""Real recordings that are configured but do not ship: where to get them, their checksums, whether they are here.

python scripts/recordings.py folder=recordings
"""

from _entry import launch  # first: it sets the number of threads

from pathlib import Path

from omegaconf import DictConfig

from vehicle_sbi.data.elsewhere import listed
from vehicle_sbi.errors import InputError


@launch("recordings")
def main(cfg: DictConfig) -> None:
    folder = Path(cfg.folder)
    if folder.exists() and not folder.is_dir():
        raise InputError(f"folder = {folder}; it is no folder")
    print(f"in {folder.resolve()}, from folder= or the environment variable VEHICLE_SBI_RECORDINGS:")
    for one in listed():
        print("\n".join(["", *one.lines(folder)]))


if __name__ == "__main__":
    main()
