"""Gather run folders into one table, as the paper's Table II: python scripts/report.py runs=[outputs/sweep]"""

from _entry import launch

from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig

from vehicle_sbi.report.tables import gather


@launch("report")
def main(cfg: DictConfig) -> None:
    folder = Path(HydraConfig.get().runtime.output_dir)
    gathered = gather(Path(run) for run in ([cfg.runs] if isinstance(cfg.runs, str) else cfg.runs))
    gathered.write(folder)
    print(f"{gathered.markdown()}\n{folder / 'runs.md'}, runs.csv, seeds.csv")


if __name__ == "__main__":
    main()
