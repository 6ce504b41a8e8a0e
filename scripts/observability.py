"""What a manoeuvre or a recording could tell of the parameters, and of the physics left out, without any inference.

python scripts/observability.py manoeuvre=paper_strong 'effects=[body_roll,accelerometer_scale]'
"""

from _entry import launch, named_recordings  # first: it sets the number of threads

from hydra.utils import instantiate
from omegaconf import DictConfig


@launch("config")
def main(cfg: DictConfig) -> None:
    from vehicle_sbi.report.observability import left_out, observability
    from vehicle_sbi.report.tables.text import markdown

    prepared = instantiate(named_recordings(cfg).study).prepare()
    for table, notes in (observability(prepared), left_out(prepared)):
        print(markdown(table), *notes, "", sep="\n")


if __name__ == "__main__":
    main()
