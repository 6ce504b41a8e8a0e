"""The recording that ships with the package: 80 s of a recording that its authors published under the MIT licence.

python benchmarks/excerpt.py ../shared/recordings/ferrari_250lm
"""

import shutil
import sys
from pathlib import Path

import pandas as pd

from vehicle_sbi.command import RECORDINGS

FROM_S, TO_S = 40.0, 120.0
COLUMNS = {"road_wheel_angle_rad": "steering_rad"}
LEFT_OUT = ["sideslip_rad"]  # which is v_y over v_x


def main(folder: Path) -> None:
    whole = pd.read_csv(folder / "targa66_first_300s.csv")
    part = whole[whole["time_s"].between(FROM_S, TO_S)].rename(columns=COLUMNS).drop(columns=LEFT_OUT)
    part.astype({name: "float32" for name in part.columns if name != "time_s"}).to_parquet(
        RECORDINGS / "ferrari_250lm_excerpt.parquet", index=False
    )
    shutil.copyfile(folder / "LICENSE", RECORDINGS / "ferrari_250lm_LICENSE")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
