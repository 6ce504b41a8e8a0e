"""The concealed-effects benchmark: cases whose truth is sealed, diagnosed from their files alone, and scored.

python scripts/prove.py cases=400 workers=2
python scripts/prove.py cases=400 engine=dask scheduler=tcp://10.0.0.1:8786
"""

from _entry import launch  # first: it sets the number of threads

import sys
from pathlib import Path

from omegaconf import DictConfig

from vehicle_sbi.errors import InputError
from vehicle_sbi.fleet.engine import Engine

ROOT = Path(__file__).resolve().parent.parent


@launch("prove")
def main(cfg: DictConfig) -> None:
    if not isinstance(cfg.cases, int) or cfg.cases < 1:
        raise InputError(f"cases = {cfg.cases!r}; it must be a whole number above 0")
    if not isinstance(cfg.first, int) or not 0 <= cfg.first < cfg.cases:
        raise InputError(f"first = {cfg.first!r}; it must be a case before cases = {cfg.cases}, counted from 0")
    engine = Engine(name=cfg.engine.name, workers=cfg.workers, scheduler=cfg.scheduler, computing=True)
    sys.path.append(str(ROOT / "benchmarks"))
    from campaign import Diagnoser, prove  # here, not above: what is refused needs none of the libraries

    print(
        prove(
            folder=Path(cfg.folder),
            results=Path(cfg.results),
            n=cfg.cases,
            first=cfg.first,
            seed=cfg.seed,
            mix=cfg.mix,
            engine=engine,
            diagnosed=cfg.diagnose,
            baselines=cfg.baselines,
            by=Diagnoser(
                name=cfg.name,
                script=Path(cfg.script),
                tree=Path(cfg.tree).resolve() if cfg.tree else ROOT,
                timeout_s=cfg.timeout_s,
                forks=engine.name == "local",
            ),
            beside=list(cfg.beside),
        )
    )


if __name__ == "__main__":
    main()
