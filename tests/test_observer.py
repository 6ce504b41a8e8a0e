"""Laws of the benchmark's observer: its evidence is the dense normal's, and how often it is right has closed forms."""

from itertools import pairwise

import numpy as np
import pytest
from concealed import observer
from concealed.drives import Plan, car
from concealed.setups import recording
from concealed.strength import Given, Noise
from concealed.worlds import OwnModel
from scipy.stats import norm

from vehicle_sbi.data.recording import Recording
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS

CAR = car(np.random.default_rng(3), relaxed=False, body=False)
STIFFNESS = CAR.C_alpha_f or 0.0


def test_evidence_is_that_of_the_dense_normal() -> None:
    rng = np.random.default_rng(1)
    G, seen = rng.standard_normal((5, 7)), rng.standard_normal((3, 7))
    rows = (0, 2, 3)
    found = observer.evidence(G @ G.T, seen @ G.T, rows)
    C = np.eye(7) + G[list(rows)].T @ G[list(rows)]
    precision = np.linalg.inv(C)
    dense = [-0.5 * r @ precision @ r - 0.5 * np.log(np.linalg.det(C)) + 0.5 * r @ r for r in seen]
    assert np.allclose(found, dense, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("snr", [0.5, 1.0, 2.0, 4.0])
def test_of_two_directions_at_right_angles_the_larger_is_named(snr: float) -> None:
    # |b_1| > |b_2| for b ~ N((snr, 0), 1) where (b_1 - b_2)(b_1 + b_2) > 0, and these are independent, N(snr, 2) both.
    gram = observer.TYPICAL**2 * np.eye(2)
    asked = observer.hypotheses(["a", "b"], [(0,), (1,)], 1)
    share = observer.share_right(gram, np.array([observer.TYPICAL * snr, 0.0]), asked, frozenset(["a"]))
    same = norm.cdf(snr / np.sqrt(2.0))
    expected = same**2 + (1.0 - same) ** 2
    assert abs(share - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / observer.DRAWS)


@pytest.mark.parametrize("names", ["abc", "aab"])
def test_what_is_one_and_the_same_shares_the_first_place_in_however_many_shapes(names: str) -> None:
    gram = observer.TYPICAL**2 * np.ones((3, 3))
    asked = observer.hypotheses(list(names), [(0,), (1,), (2,)], 1)
    share = observer.share_right(gram, gram[0], asked, frozenset(["b"]))
    assert share == pytest.approx(1.0 / len(set(names)), rel=1e-12)


def test_sets_hold_different_effects_in_every_shape() -> None:
    found = observer.hypotheses(["a", "a", "b"], [(0,), (1,), (2, 3)], 2)
    assert [(one.effects, one.rows) for one in found] == [(frozenset("ab"), (0, 2, 3)), (frozenset("ab"), (1, 2, 3))]


def driven(given: Given) -> Recording:
    t = np.arange(501) / 50.0
    steering = 0.02 * np.sin(np.pi * t) * np.clip(t, 0.0, 1.0)
    plan = Plan(t=t, steering=steering, acceleration=np.zeros_like(t), v_0=20.0, manoeuvre="sine")
    series = OwnModel(car=CAR, model="single_track", drive_mode="speed", gain=1.0).drive(plan, {})
    assert series is not None
    return recording("a", plan, series, given, {})


def test_a_name_is_the_surer_the_more_it_changes() -> None:
    given = Given(
        vehicle=CAR, model="single_track", drive="speed", channels=("a_y", "yaw_rate"),
        prior={"C_alpha_f": (0.7 * STIFFNESS, 1.5 * STIFFNESS)},
    )  # fmt: skip
    noise = Noise(
        std={"a_y": 0.1, "yaw_rate": 0.004, "v_x": 0.003}, rho=dict.fromkeys(("a_y", "yaw_rate"), 0.0), tail="normal"
    )
    simulator = given.simulator([driven(given)], noise)
    bias = EFFECT_PARAMETERS["gyro_bias.z"]
    shares = [observer.share(simulator, np.array([STIFFNESS]), {bias: size}) for size in (0.0, 0.001, 0.01)]
    assert all(low < high for low, high in pairwise(shares))
    assert shares[0] < 0.2  # hardly more than one of 39
    assert shares[-1] > 0.95
