"""Parameters of one vehicle from a recording, or from a simulated drive: posterior, table, figures, page.

python scripts/run.py recording=drive.csv vehicle=car.yaml
python scripts/run.py 'recordings=[a.csv,b.csv]' vehicle=car.yaml
python scripts/run.py prior=default estimator=nsf
python scripts/run.py -m estimator=nsf,maf seed=0,1,2
"""

from _entry import launch, named_recordings, run_folder, use_engine, warn  # first: it sets the number of threads

from hydra.utils import instantiate
from omegaconf import DictConfig


@launch("config")
def main(cfg: DictConfig) -> None:
    from vehicle_sbi.inference.rounds import file_of, infer
    from vehicle_sbi.report.results import first_answer, report, show

    study, scheme = instantiate(named_recordings(cfg).study), instantiate(cfg.rounds)
    use_engine(cfg.engine)
    prepared = study.prepare()
    warn(prepared.warnings)
    with run_folder(cfg, inputs=prepared.inputs) as folder:
        if not folder.finished:
            if not folder.checkpoints.kept(file_of(0)):
                with folder.stage("first answer"):
                    print(first_answer(prepared.problem, cfg.effects), flush=True)
            with folder.stage("rounds"):
                inference = infer(prepared.problem, scheme, folder.checkpoints, warn=warn)
            report(folder, prepared, inference, samples=cfg.samples, reweight=cfg.reweight)
        show(folder)


if __name__ == "__main__":
    main()
