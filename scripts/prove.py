"""The concealed-effects benchmark: cases whose truth is sealed, diagnosed from their files alone, and scored.

python scripts/prove.py cases=400 workers=2
"""

from _entry import launch  # first: it sets the number of threads

import sys
from pathlib import Path

from omegaconf import DictConfig

from vehicle_sbi.errors import InputError

ROOT = Path(__file__).resolve().parent.parent


@launch("prove")
def main(cfg: DictConfig) -> None:
    sys.path.append(str(ROOT / "benchmarks"))
    from campaign import Diagnoser, prove

    for name, value in (("cases", cfg.cases), ("workers", cfg.workers)):
        if not isinstance(value, int) or value < 1:
            raise InputError(f"{name} = {value!r}; it must be a whole number above 0")
    print(
        prove(
            folder=Path(cfg.folder),
            results=Path(cfg.results),
            n=cfg.cases,
            seed=cfg.seed,
            mix=cfg.mix,
            workers=cfg.workers,
            stages={"diagnose": cfg.diagnose, "baselines": cfg.baselines},
            by=Diagnoser(
                name=cfg.name,
                script=Path(cfg.script),
                tree=Path(cfg.tree).resolve() if cfg.tree else ROOT,
                timeout_s=cfg.timeout_s,
            ),
            beside=list(cfg.beside),
        )
    )


if __name__ == "__main__":
    main()
