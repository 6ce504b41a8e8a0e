"""Diagnose a folder of recordings of many vehicles: one table, one index page, a run folder for each.

python scripts/fleet.py folder=recordings
python scripts/fleet.py folder=recordings engine=dask scheduler=tcp://10.0.0.1:8786 'options=["window_s=5"]'
"""

from _entry import launch  # first: it sets the number of threads

import sys
from pathlib import Path

from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig
from tqdm import tqdm

from vehicle_sbi.command import SCRIPTS
from vehicle_sbi.files import write_text
from vehicle_sbi.fleet.engine import Engine
from vehicle_sbi.fleet.vehicles import members


@launch("fleet")
def main(cfg: DictConfig) -> None:
    out = Path(HydraConfig.get().runtime.output_dir)
    engine = Engine(name=cfg.engine.name, workers=cfg.workers, scheduler=cfg.scheduler)
    options = [f"figures={str(cfg.figures).lower()}", *map(str, cfg.options)]
    found, outcomes = members(Path(str(cfg.folder))), {}
    from vehicle_sbi.fleet.diagnoses import fleet  # here, not above: what is refused needs none of the libraries
    from vehicle_sbi.fleet.table import shown, table
    from vehicle_sbi.report.page.index import rows, write_index

    asked = fleet(found, out, engine, script=SCRIPTS / "diagnose.py", options=options, timeout_s=cfg.timeout_s)
    with tqdm(asked, total=len(found), desc="vehicles", unit="vehicle", disable=None) as bar:
        for member, outcome in bar:
            outcomes[member.name] = outcome
    together = table(outcomes, found, out)
    write_text(out / "fleet.csv", together.to_csv(index=False, float_format="%.6g"))
    write_text(out / "fleet.md", shown(together))
    print(shown(together))
    if answered := [out / name for name, one in outcomes.items() if one.answered]:
        write_index(out / "index.html", rows(answered), title=f"Fleet of {Path(str(cfg.folder)).name}")
        print(out / "index.html")
    failed = [name for name, one in outcomes.items() if not one.answered]
    for name in failed:
        print(f"error: {name}: {outcomes[name].reason}", file=sys.stderr)
    if failed:
        sys.exit(2)


if __name__ == "__main__":
    main()
