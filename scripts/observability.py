"""What a manoeuvre or a recording could tell: Fisher information, bounds and confusions, without any inference.

python scripts/observability.py manoeuvre=paper_strong effects=[body_roll,accelerometer_scale]
"""

from _entry import launch  # first: it sets the number of threads

from hydra.utils import instantiate
from omegaconf import DictConfig

from vehicle_sbi.report.observability import observability
from vehicle_sbi.report.tables import markdown


@launch("config")
def main(cfg: DictConfig) -> None:
    table, notes = observability(instantiate(cfg.study).prepare())
    print(markdown(table), *notes, sep="\n")


if __name__ == "__main__":
    main()
