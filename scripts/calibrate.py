"""Are the posteriors of a configured study calibrated? Intervals and ranks of truths that are drawn from its prior.

python scripts/calibrate.py repetitions=100 workers=2
python scripts/calibrate.py rounds=amortised repetitions=500
python scripts/calibrate.py manoeuvre=paper_strong rounds.simulations=1000 reweight=false
"""

from _entry import launch, run_folder, use_engine  # first: it sets the number of threads

from hydra.utils import instantiate
from omegaconf import DictConfig


@launch("calibrate")
def main(cfg: DictConfig) -> None:
    from vehicle_sbi.inference.repetition import calibrated, checked
    from vehicle_sbi.report.calibration import report, show

    study, scheme, asked = instantiate(cfg.study), instantiate(cfg.rounds), instantiate(cfg.calibration)
    use_engine(cfg.engine)
    asked.of(scheme)
    prepared = checked(study, scheme)
    with run_folder(cfg, inputs=prepared.inputs) as folder:
        if not folder.finished:
            with folder.stage("repetitions"):
                found = calibrated(study, scheme, prepared, asked, folder.checkpoints)
            with folder.stage("results"):
                report(folder, found, prepared.name)
        show(folder)


if __name__ == "__main__":
    main()
