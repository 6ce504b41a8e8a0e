"""Where the IMU sits, on ten seeds, from the centre of gravity and from the rear axle with an unknown one.

    .venv/bin/python benchmarks/lever_arm.py        about an hour on two cores; started again, it goes on

Runs `experiment=lever_arm` with both priors as a user would, each seed with a truth of its own, then gathers the run
folders into results/lever_arm.csv and results/lever_arm.md.
"""

from gathering import ROOT, gather, run

RUNS = ROOT / "outputs" / "lever_arm"


def main() -> None:
    run(
        "-m",
        "experiment=lever_arm",
        "prior=lever_arm,lever_arm_base_link",
        "seed=range(10)",
        "engine.cores=1",
        "hydra/launcher=joblib",
        "hydra.launcher.n_jobs=2",
        f"hydra.sweep.dir={RUNS}",
        "hydra.sweep.subdir=${hydra:runtime.choices.prior}+seed-${seed}",
    )
    print(gather("lever_arm", list(RUNS.glob("lever_arm*")), "prior"))


if __name__ == "__main__":
    main()
