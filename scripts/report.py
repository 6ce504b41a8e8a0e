"""Gather run folders: one table, as the paper's Table II, and an index page over runs and diagnoses alike.

python scripts/report.py runs=outputs/sweep
"""

from _entry import launch

from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig


@launch("report")
def main(cfg: DictConfig) -> None:
    from vehicle_sbi.report.page.index import BROKEN, COMPLETE, RUN, rows, write_index
    from vehicle_sbi.report.tables.gathered import gather

    folder = Path(HydraConfig.get().runtime.output_dir)
    found = rows(Path(run) for run in ([cfg.runs] if isinstance(cfg.runs, str) else cfg.runs))
    if any(row.kind == RUN and row.status == COMPLETE for row in found):
        gathered = gather(row.path for row in found if row.kind == RUN and row.status != BROKEN)
        gathered.write(folder)
        print(f"{gathered.markdown()}\n{folder / 'runs.md'}, runs.csv, seeds.csv")
    write_index(folder / "index.html", found)
    for row in found:
        if row.status == BROKEN:
            print(f"{row.path}: {row.headline}")
    print(folder / "index.html")


if __name__ == "__main__":
    main()
