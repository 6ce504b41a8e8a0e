"""Laws of the benchmark's observer: its evidence is the dense normal's, and how often it is right has closed forms."""

from itertools import pairwise

import numpy as np
import pytest
from concealed import observer
from concealed.drives import Plan, car
from concealed.mix import SNRS
from concealed.setups import recording
from concealed.strength import Given, Noise
from concealed.worlds import OwnModel
from scipy.stats import norm

from vehicle_sbi.data.recording import Recording
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS

CAR = car(np.random.default_rng(3), relaxed=False, body=False)
STIFFNESS = CAR.C_alpha_f or 0.0


def test_evidence_is_that_of_dense_normals_one_for_each_strength() -> None:
    rng = np.random.default_rng(1)
    G, seen = rng.standard_normal((5, 7)), rng.standard_normal((3, 7))
    one = observer.Hypothesis(frozenset("ab"), (0, 2, 3), (1.0, np.sqrt(0.5), np.sqrt(0.5)))
    found = observer.evidence(G @ G.T, seen @ G.T, one)
    each = []
    for snr in SNRS:
        g = snr * np.array(one.shares)[:, None] * G[list(one.rows)]
        C = np.eye(7) + g.T @ g
        misfit = np.einsum("di,ij,dj->d", seen, np.linalg.inv(C) - np.eye(7), seen)
        each.append(-0.5 * misfit - 0.5 * np.log(np.linalg.det(C)))
    assert np.allclose(found, np.log(np.mean(np.exp(each), axis=0)), rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("snr", [0.5, 1.0, 2.0, 4.0])
def test_of_two_directions_at_right_angles_the_larger_is_named(snr: float) -> None:
    # |b_1| > |b_2| for b ~ N((snr, 0), 1) where (b_1 - b_2)(b_1 + b_2) > 0, and these are independent, N(snr, 2) both.
    asked = observer.hypotheses(["a", "b"], [(0,), (1,)], 1)
    rate = observer.rate(np.eye(2), np.array([snr, 0.0]), asked, frozenset(["a"]))
    same = norm.cdf(snr / np.sqrt(2.0))
    expected = same**2 + (1.0 - same) ** 2
    assert abs(rate - expected) < 4.0 * np.sqrt(expected * (1.0 - expected) / observer.DRAWS)


@pytest.mark.parametrize("names", ["abc", "aab"])
def test_what_is_one_and_the_same_shares_the_first_place_in_however_many_shapes(names: str) -> None:
    asked = observer.hypotheses(list(names), [(0,), (1,), (2,)], 1)
    rate = observer.rate(np.ones((3, 3)), np.full(3, 8.0), asked, frozenset(["b"]))
    assert rate == pytest.approx(1.0 / len(set(names)), rel=1e-12)


@pytest.mark.parametrize("true", ["many", "one"])
def test_an_effect_with_many_directions_is_named_as_one_with_a_single_one_is(true: str) -> None:
    # The other's products are noise alone. At a signal-to-noise ratio of 16 the likelihood gains some 128 on it.
    asked = observer.hypotheses(["many", "one"], [tuple(range(12)), (12,)], 1)
    meant = np.zeros(13)
    meant[slice(12) if true == "many" else slice(12, 13)] = 16.0 / np.sqrt(12 if true == "many" else 1)
    assert observer.rate(np.eye(13), meant, asked, frozenset([true])) == 1.0


def test_sets_hold_different_effects_in_every_shape_and_directions_share_their_effect() -> None:
    first, second = observer.hypotheses(["a", "a", "b"], [(0,), (1,), (2, 3)], 2)
    assert (first.effects, first.rows, second.rows) == (frozenset("ab"), (0, 2, 3), (1, 2, 3))
    assert np.square(first.shares) == pytest.approx([1.0, 0.5, 0.5])


def test_another_effect_is_taken_where_it_changes_as_much_inside_its_box() -> None:
    angle, g = EFFECT_PARAMETERS["road_bank.angle"], np.array([300.0, 400.0])  # per rad, within 0.1 rad
    assert observer._as_large(angle, g, 0.02 * g) == pytest.approx(0.02)
    assert observer._as_large(angle, g, -0.02 * g) == pytest.approx(-0.02)
    assert observer._as_large(angle, g, 5.0 * g) == angle.high
    delay = EFFECT_PARAMETERS["steering_delay.time"]  # from 0 on: there is no other side
    assert 0.0 < observer._as_large(delay, g, -0.02 * g) < 0.1 * delay.high
    assert observer._as_large(delay, np.zeros(2), g) == delay.high


def driven(given: Given) -> Recording:
    t = np.arange(501) / 50.0
    steering = 0.02 * np.sin(np.pi * t) * np.clip(t, 0.0, 1.0)
    plan = Plan(t=t, steering=steering, acceleration=np.zeros_like(t), v_0=20.0, manoeuvre="sine")
    series = OwnModel(car=CAR, model="single_track", drive_mode="speed", gain=1.0).drive(plan, {})
    assert series is not None
    return recording("a", plan, series, given, {})


@pytest.fixture(scope="module")
def recorded() -> observer.Recorded:
    given = Given(
        vehicle=CAR, model="single_track", drive="speed", channels=("a_y", "yaw_rate"),
        prior={"C_alpha_f": (0.7 * STIFFNESS, 1.5 * STIFFNESS)},
    )  # fmt: skip
    noise = Noise(
        std={"a_y": 0.1, "yaw_rate": 0.004, "v_x": 0.003}, rho=dict.fromkeys(("a_y", "yaw_rate"), 0.0), tail="normal"
    )
    fitted, both = (given.simulator([driven(given)] * n, noise) for n in (1, 2))
    return observer.Recorded(fitted, both, np.array([STIFFNESS]))


def test_a_name_is_the_surer_the_more_it_changes_and_the_more_is_recorded(recorded: observer.Recorded) -> None:
    bias = {EFFECT_PARAMETERS["gyro_bias.z"]: 0.001}
    found = [recorded.rates(bias, snr) for snr in (0.01, 3.0, 16.0)]
    assert all(low["fitted"] < high["fitted"] for low, high in pairwise(found))
    assert found[0]["fitted"] < 0.2  # hardly more than one of 39
    assert found[1]["fitted"] < found[1]["all"]  # the same once more: sqrt(2) times the ratio
    assert found[-1]["fitted"] > 0.95


def test_what_comes_and_goes_is_found_among_its_moments_and_pairs_are_both_found(recorded: observer.Recorded) -> None:
    values = {"force": 800.0, "arm": 0.4, "start": 3.3, "duration": 2.2}
    gust = {EFFECT_PARAMETERS[f"gust.{key}"]: value for key, value in values.items()}
    assert recorded.rates(gust, 32.0)["fitted"] > 0.9
    pair = gust | {EFFECT_PARAMETERS["gyro_bias.z"]: 0.01}
    assert recorded.rates(pair, 32.0)["fitted"] > 0.5


def test_an_effect_that_does_not_act_has_no_rate(recorded: observer.Recorded) -> None:
    silent = {EFFECT_PARAMETERS["drive_gain.gain"]: 1.2}
    for truth in (silent, silent | {EFFECT_PARAMETERS["gyro_bias.z"]: 0.01}):
        with pytest.raises(RuntimeError, match="not all of it acts"):
            recorded.rates(truth, 8.0)
