"""The catalogue of effects, written anew as docs/effects.md: equations, parameters and pictures.

python scripts/catalogue.py folder=docs
"""

from _entry import launch  # first: it sets the number of threads

from pathlib import Path

from hydra.utils import instantiate
from omegaconf import DictConfig

from vehicle_sbi.report.catalogue import write


@launch("catalogue")
def main(cfg: DictConfig) -> None:
    write(Path(cfg.folder), instantiate(cfg.vehicle), instantiate(cfg.manoeuvre), cfg.model.name)
    print(f"{cfg.folder}/effects.md")


if __name__ == "__main__":
    main()
