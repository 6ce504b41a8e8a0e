"""What the diagnosis says of real cars, beside what is known of them.

    .venv/bin/python benchmarks/real_recordings.py        twenty-five minutes of one core; started again, it goes on

Runs scripts/diagnose.py as a user would, and writes results/real_recordings.md. What is known is in docs/recordings.
"""

import json
import os
import platform
import subprocess
import sys
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from gathering import RESULTS, ROOT

from vehicle_sbi.files import write_text
from vehicle_sbi.mismatch.selection.extended import Extended
from vehicle_sbi.physics.effects import KNOTS
from vehicle_sbi.physics.single_track import INPUTS
from vehicle_sbi.report.stage_file import read
from vehicle_sbi.report.tables.text import markdown

RUNS = ROOT / "outputs" / "real_recordings"
SHARED = Path(os.environ.get("VEHICLE_SBI_RECORDINGS", ROOT.parent / "shared" / "recordings"))
DART = SHARED / "dart_jetracer" / "40_sinusoidal_steering_data" / "car_1_Datarecording_01_22_2024_"
CASES = {
    "phone": ["recordings=[toyota_rav4_phone]"],
    "car": ["recordings=[toyota_rav4_car]"],
    "volvo": ["recordings=[volvo_s90_slalom]"],
    "volvo_mixed": ["recordings=[volvo_s90_slalom_mixed]"],
    "ferrari": ["recordings=[ferrari_250lm]"],
    "ferrari_unsaturated": ["recordings=[ferrari_250lm]", "vehicle.mu=3"],
    "dart": [
        "recording=dart_sine_steering",
        f"recordings=[{','.join(f'{DART}{time}.csv' for time in ('11_45_12', '11_42_22', '11_39_01'))}]",
        f"heldout=[{','.join(f'{DART}{time}.csv' for time in ('11_44_35', '11_41_28'))}]",
    ],
}
Verdict = dict[str, Any]


def diagnosed(name: str) -> Verdict:
    """The verdict of a case, from its folder where it is finished."""
    script, folder = ROOT / "scripts" / "diagnose.py", RUNS / name
    subprocess.run([sys.executable, str(script), *CASES[name], f"hydra.run.dir={folder}"], cwd=ROOT, check=True)
    return json.loads((folder / "verdict.json").read_text())


def grade(name: str) -> tuple[float, float, float]:
    """Of the posterior's mean profile against the true one, over the seconds that were fitted: correlation, root mean
    square error [deg], the same without its mean."""
    model = read(RUNS / name / "stages" / "extended.npz", Extended).model
    windows, said = model.fit.simulator.windows, model.estimates
    fitted = windows.valid.any(axis=0)
    clock, t = (x.reshape(-1)[fitted] for x in (windows.u[..., INPUTS.index("time")], windows.t))
    names = [f"road_grade_profile.angle_{k}" for k in range(KNOTS)]
    knots = [said[name].mean if name in said else 0.0 for name in names]  # nothing shows of one where all is held out
    end = windows.u[..., INPUTS.index("time")].max()
    profile = np.interp(clock, np.linspace(0.0, end, KNOTS), knots)
    truth = pd.read_csv(SHARED / "toyota_rav4" / "truth_grade.csv")
    true = np.interp(t, truth["time_s"], truth["road_grade_rad"])
    error = np.degrees(profile - true)
    return float(np.corrcoef(profile, true)[0, 1]), float(np.sqrt(np.mean(error**2))), float(error.std())


def size(verdict: Verdict, parameter: str) -> str:
    """Of the likeliest set that has it, with its 90 % interval; else of one whose size may be nothing."""
    for sets, but in ((verdict["explanations"], ""), (verdict["unsupported"], ", not named: it may be nothing")):
        if one := next((e["parameters"][parameter] for e in sets if parameter in e["parameters"]), None):
            return f"{_estimate(one, one['unit'])}{but}"
    return "not in any set"


def base(verdict: Verdict, parameter: str, when: str = "after") -> str:
    """A base parameter before or after the diagnosis."""
    one = verdict["base_parameters"][parameter]
    return _estimate(one[when], one["unit"])


def _estimate(one: dict[str, float], unit: str) -> str:
    said = f"{one['mean']:.3g} ± {one['std']:.2g} {unit}".removesuffix(" 1")
    return f"{said} ({one['q05']:.3g} to {one['q95']:.3g})"


def probability(verdict: Verdict, *effects: str) -> str:
    """Of each effect, whatever else is missing."""
    return ", ".join(f"{name} {verdict['effects'].get(name, 0.0):.2f}" for name in effects)


def rows() -> list[tuple[str, str, str]]:
    """What is asked of each recording, and what is said."""
    said = {name: diagnosed(name) for name in CASES}
    correlation, error, without_mean = grade("phone")
    none_of = ("road_grade", "road_grade_profile", "road_bank", "imu_lever_arm", "imu_misalignment", "downforce")
    return [
        ("Toyota RAV4, phone", "the grade, not given", probability(said["phone"], "road_grade_profile")),
        ("", "its profile: correlation over 0.9", f"{correlation:.3f}"),
        ("", "RMS error under 0.5 deg", f"{error:.2f} deg; {without_mean:.2f} deg without its mean"),
        ("Toyota RAV4, the car", "no grade", probability(said["car"], "road_grade", "road_grade_profile")),
        ("Volvo S90", "body roll, or what is like it", probability(said["volvo"], "body_roll", "accelerometer_scale")),
        ("", "0.0080 rad/(m/s²) within 25 %", size(said["volvo"], "body_roll.gradient")),
        ("", "a delay of 35 to 50 ms", size(said["volvo"], "sensor_delay.can")),
        ("", "relaxation: 0.3 to 0.6 m", size(said["volvo"], "relaxation.front")),
        ("", "steering gain 1", base(said["volvo"], "steering_ratio.gain")),
        ("", "C_alpha_f of 120 to 200 kN/rad", base(said["volvo"], "C_alpha_f")),
        ("", "no gust", probability(said["volvo"], "gust")),
        ("Volvo S90, a_y of the VBOX", "a delay", probability(said["volvo_mixed"], "sensor_delay", "steering_delay")),
        ("", "the yaw rate 45 ms later", size(said["volvo_mixed"], "sensor_delay.can")),
        ("", "a_y not", size(said["volvo_mixed"], "sensor_delay.imu")),
        ("Ferrari 250 LM, mu = 3", "saturating tyres", probability(said["ferrari_unsaturated"], "friction_level")),
        ("", "a friction of 1.1 to 1.2, over 3", size(said["ferrari_unsaturated"], "friction_level.factor")),
        ("", "no grade, bank or lever arm", probability(said["ferrari_unsaturated"], *none_of)),
        ("Ferrari 250 LM, mu = 1.2", "something else", f"unknown {said['ferrari']['p_unknown']:.2f}"),
        ("", "driven from the right seat", probability(said["ferrari"], "lateral_cog")),
        ("", "a few centimetres to the right", size(said["ferrari"], "lateral_cog.y")),
        ("", "no grade, bank or lever arm", probability(said["ferrari"], *none_of)),
        ("DART 1:10", "a steering lag", probability(said["dart"], "steering_lag", "steering_delay", "sensor_delay")),
        ("", "0.1285 s", size(said["dart"], "steering_lag.time")),
        ("", "friction as stated", probability(said["dart"], "friction_level")),
    ]


def main() -> None:
    table = pd.DataFrame(rows(), columns=["recording", "known", "said"])
    text = f"{markdown(table)}\n{date.today()}, {platform.platform()}.\n"
    write_text(RESULTS / "real_recordings.md", text)
    print(text)


if __name__ == "__main__":
    main()
