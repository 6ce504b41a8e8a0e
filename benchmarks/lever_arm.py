"""Where the IMU sits, on ten seeds, from the centre of gravity and from the rear axle with an unknown one.

    .venv/bin/python benchmarks/lever_arm.py        about an hour on two cores; started again, it goes on

Runs `experiment=lever_arm` with both priors as a user would, each seed with a truth of its own, then gathers the run
folders into results/lever_arm.csv and results/lever_arm.md, and draws docs/lever_arm.png.
"""

from pathlib import Path

import matplotlib
import pandas as pd
from gathering import RESULTS, ROOT, gather, run
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from vehicle_sbi.report.figures import POSTERIOR, STYLE, TRUTH, key, save

RUNS = ROOT / "outputs" / "lever_arm"
SETTINGS = {"lever_arm": "from the centre of gravity", "lever_arm_base_link": "from the rear axle"}


def errors(axis: Axes, table: pd.DataFrame) -> float:
    """Posterior means less the truth [cm] with their 90 % intervals, one line per seed; returns how far they reach."""
    less = 100.0 * table[["q05", "mean", "q95"]].sub(table["true"], axis=0)
    axis.axvline(0.0, color=TRUTH, linewidth=1.0)
    axis.hlines(table["seed"], less["q05"], less["q95"], color=POSTERIOR, linewidth=2.0)
    axis.plot(less["mean"], table["seed"], "o", color=POSTERIOR, markersize=4.0)
    axis.set_yticks([])
    return float(less.abs().to_numpy().max())


def draw(table: pd.DataFrame, path: Path) -> None:
    """One row of panels per setting, one panel per axis of the IMU's place."""
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(8.0, 4.6), layout="constrained")
        panels = figure.subplots(len(SETTINGS), 3, sharex="col")
        for column, name in zip(panels.T, "xyz", strict=True):
            of_axis = table[table["parameter"].isin([f"imu_lever_arm.{name}", f"imu_{name}"])]
            each = [of_axis[of_axis["prior"] == prior] for prior in SETTINGS]
            reach = 1.1 * max(errors(axis, part) for axis, part in zip(column, each, strict=True))
            column[0].set_xlim(-reach, reach)
            column[-1].set_xlabel(f"{name}, estimate less truth [cm]")
        for axis, (prior, setting) in zip(panels[:, 0], SETTINGS.items(), strict=True):
            axis.set_ylabel(f"{setting}\n{table.loc[table['prior'] == prior, 'seed'].nunique()} drives")
        save(figure, path, [key("truth", TRUTH), key("mean and 90 % interval", POSTERIOR, marker="o")])


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
    draw(pd.read_csv(RESULTS / "lever_arm.csv"), ROOT / "docs" / "lever_arm.png")


if __name__ == "__main__":
    main()
