"""The door of every script: Hydra's configuration in, one-line errors out, and a run folder named after what was asked.

Import it before anything else: numpy and torch read the number of their threads when they are imported. It is one,
whatever the environment says: sums would depend on it, and the cores belong to numba's simulations.

    from _entry import launch

    @launch("config")
    def main(cfg: DictConfig) -> None:
        from vehicle_sbi.inference.rounds import infer  # here, not above: help and a wrong option need no torch

    if __name__ == "__main__":
        main()

A wrong value prints one line `error: …` and exits with status 2; HYDRA_FULL_ERROR=1 shows the traceback instead. In a
sweep every failing job prints its line, the others run on, and the status is 2. Anything else is a bug and keeps its
traceback.
"""

from _entry import interruption

interruption.listen()

from _entry.cores import use_engine
from _entry.launching import launch
from _entry.recordings import named_recordings, warn
from _entry.run_folders import LONGEST_NAME, run_folder, study_name
from _entry.targets import guard

import os

from vehicle_sbi.command import print_anywhere

__all__ = ["LONGEST_NAME", "launch", "named_recordings", "run_folder", "study_name", "use_engine", "warn"]

guard()
print_anywhere()

# What is imported above imports neither numpy nor torch; tests/test_entry.py holds it to that.
for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"
