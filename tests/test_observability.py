"""What a manoeuvre could tell is said in words that follow from its Fisher matrix."""

import numpy as np
import pytest
from script_runs import run_script

from vehicle_sbi.report.observability import condition


def test_condition_is_that_of_the_information_per_prior() -> None:
    # In units of priors 1 and 10 the information 4 and 1 is 4 and 100.
    F, prior_std = np.diag([4.0, 1.0]), np.array([1.0, 10.0])
    assert condition(F, prior_std) == pytest.approx(25.0)
    assert condition(np.diag([4.0, 0.0]), prior_std) == np.inf


def test_the_script_names_what_one_sine_cannot_tell_apart() -> None:
    # In steady phase a_y (1 + g gradient) is a_y gain: body roll is an accelerometer's gain. Grade and bias of a_x both
    # add a constant to it, but grade also slows the car, which wheel speeds show.
    status, out, err = run_script(
        "observability",
        "truth={l_f: 1.2, body_roll.gradient: 0.008, body_roll.lag: 0.05, body_roll.period: 0.5, "
        "accelerometer_scale.x: 1.0, accelerometer_scale.y: 1.0}",
        "prior=lateral",
        "~prior.C_alpha_f",
        "~prior.C_alpha_r",
        "~prior.steering_ratio",
        "effects=[body_roll,accelerometer_scale]",
    )
    assert status == 0, err
    assert "Condition number" in out
    pair = next(line for line in out.splitlines() if line.startswith("Hardly told apart"))
    assert "body_roll.gradient" in pair
    assert "accelerometer_scale.y" in pair
    assert "absorbed by" in out
