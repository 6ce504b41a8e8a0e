"""The full vehicle model beside an independent multi-body car on three parameter sets: a sine with braking."""

import numpy as np
import pytest

multibody = pytest.importorskip("multibody")

PLANAR = ("a_x", "a_y", "yaw_rate", "v_x", "v_y")


@pytest.mark.slow
@pytest.mark.parametrize("number", multibody.SETS)
def test_on_the_same_tyres_the_planar_motion_differs_by_less_than_the_body_s_sway(number: int) -> None:
    # The multi-body car takes slip angles at its sprung mass, which sways over the axles; ours at the axles. That
    # changes a slip angle by sway/v, and forces with it by this share of the slip angles' own size; the front and rear
    # axles' slip angles are taken together, as the lateral force is. Everything else is of second order in the roll
    # angle (0.04) or the steering angle (0.03).
    p = multibody.SETS[number]()
    with multibody.dugoff_tyres(p):
        theirs = multibody.multibody(p)
    ours = multibody.full_vehicle(p, theirs["delta"], load_sensitivity_coefficient=1.0)
    v_x, v_y, r = theirs["v_x"], theirs["v_y"], theirs["yaw_rate"]
    slip = np.concatenate([theirs["delta"] - (v_y + p.a * r) / v_x, -(v_y - p.b * r) / v_x])
    share = np.sqrt(np.mean((theirs["sway"] / v_x) ** 2) / np.mean(slip**2))
    residual = multibody.nrmse(ours, theirs)
    assert share < 0.5
    assert {c: residual[c] for c in PLANAR if residual[c] > share + 0.04} == {}


def test_both_roll_to_the_outside_and_dive_under_braking() -> None:
    p = multibody.SETS[2]()
    theirs = multibody.multibody(p)
    ours = multibody.full_vehicle(p, theirs["delta"])
    for channel in ("roll_rate", "pitch_rate"):
        assert np.corrcoef(ours[channel], theirs[channel])[0, 1] > 0.9
