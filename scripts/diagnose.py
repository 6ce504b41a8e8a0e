"""Where simulation and recordings differ, what physics was left out, and whether modelling it helps on held-out data.

python scripts/diagnose.py recording=drive.csv vehicle=car.yaml
python scripts/diagnose.py 'recordings=[a.csv,b.csv]' 'heldout=[c.csv]' vehicle=car.yaml
python scripts/diagnose.py recording=volvo_s90_slalom
"""

from _entry import launch, named_recordings, run_folder, use_engine, warn  # first: it sets the number of threads

from hydra.utils import instantiate
from omegaconf import DictConfig


@launch("diagnose")
def main(cfg: DictConfig) -> None:
    from vehicle_sbi.mismatch.selection import ahead

    use_engine(cfg.engine)
    ahead.begin()  # before what takes seconds to import
    from vehicle_sbi.report.diagnosis import diagnose, show

    diagnosis, again = instantiate(named_recordings(cfg).diagnosis), instantiate(cfg.get("infer"))
    case = diagnosis.prepare()
    warn(case.warnings)
    with run_folder(cfg, inputs=case.inputs) as folder:
        if not folder.finished:
            diagnose(folder, case, again, seed=cfg.seed, figures=cfg.figures)
        show(folder)


if __name__ == "__main__":
    main()
