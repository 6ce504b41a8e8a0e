"""What is said of numbers and lists: closed forms."""

import re
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import yaml
from cars import PAPER

from vehicle_sbi.mismatch.answer.schema import Named, Outgrown, Unknown
from vehicle_sbi.mismatch.answer.wording import (
    TOO_SMALL,
    _its_set,
    _left,
    _proof,
    _shown,
    _sizes,
    in_the_car,
    spoken_p,
    widen,
)
from vehicle_sbi.mismatch.estimation.estimate import Estimate
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.selection.score_test import DRAWS
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.physics.record import nominal_record
from vehicle_sbi.words import enumerated

HALF = Estimate(0.5, 0.1, 0.4, 0.6, "1")


@pytest.mark.parametrize(
    ("words", "said"), [([], ""), (["a"], "a"), (["a", "b"], "a and b"), (["a", "b", "c"], "a, b and c")]
)
def test_lists(words: list[str], said: str) -> None:
    assert enumerated(words) == said


def test_a_p_value_that_no_draw_of_noise_reaches_is_a_bound() -> None:
    least = 1.0 / (DRAWS + 1)
    assert [spoken_p(p) for p in (least, 2.0 * least, 0.05)] == ["p ≤ 0.002", "p = 0.004", "p = 0.05"]


def test_a_factor_is_said_of_what_the_vehicle_file_states() -> None:
    nominal = nominal_record(PAPER)
    assert (
        in_the_car("friction_level.factor", HALF, nominal) == f" (mu {0.5 * nominal['mu']:.3g}, stated {PAPER.mu:.3g})"
    )
    assert in_the_car("payload.mass", HALF, nominal) == f" (beside m {PAPER.m:.4g})"
    assert in_the_car("yaw_inertia.factor", HALF, nominal) == ""  # this file states none
    assert in_the_car("steering_ratio.gain", HALF, nominal) == ""


def test_of_each_effect_the_size_that_is_most_certain_is_said_before_any_other() -> None:
    sizes = {
        "relaxation.front": Estimate(0.2, 0.1, 0.0, 0.4, "m"),
        "relaxation.rear": Estimate(0.5, 0.1, 0.3, 0.7, "m"),
        "imu_lever_arm.x": Estimate(0.5, 0.1, 0.3, 0.7, "m"),
        **{f"friction_level.{one}": Estimate(1.0, 0.1, 0.9, 1.1, "1") for one in ("factor", "rear")},
        **{f"stiffness_level.{one}": Estimate(1.1, 0.1, 1.0, 1.3, "1") for one in ("factor", "front", "rear")},
    }
    effects = dict.fromkeys(("relaxation", "imu_lever_arm", "friction_level", "stiffness_level"), 0.9)
    simulator: Any = SimpleNamespace(nominal=nominal_record(PAPER))
    answer: Any = SimpleNamespace(
        explanations=[Named(tuple(effects), 0.9, 0.0, sizes, {})], effects=effects, mismatch=[], p_value=0.008,
        indistinguishable=[], p_indistinguishable=[], headline="Missing: relaxation (0.90), and 3 more.",
    )  # fmt: skip
    said = _sizes(answer, simulator)
    assert "Also missing: imu lever arm (0.90), friction level (0.90), stiffness level (0.90)." in said
    main = said[said.index("relaxation.rear") :].split("; ")
    assert [one.split(" ")[0].split(".")[0] for one in main[:4]] == [*effects]
    assert main[-1] == "and 3 more."


def test_what_the_extended_model_has_beside_the_headline_and_lacks_of_it() -> None:
    answer: Any = SimpleNamespace(
        explanations=[Named(("body_roll", "gust"), 0.6, 0.1, {}, {})],
        effects={"body_roll": 0.9, "relaxation": 0.6, "gust": 0.4},
    )
    said = _its_set(answer)
    assert said.startswith(" Its set of effects is the likeliest (70 % of draws); base parameters are")
    assert said.endswith(" Its own has the effects above, with gust, without relaxation.")
    answer.effects = {"body_roll": 0.9, "gust": 0.7, "relaxation": 0.1}
    assert _its_set(answer) == ""


@pytest.mark.parametrize(
    ("probabilities", "said"),
    [
        (
            (0.010, 0.007, 0.006, 0.001),
            "2 other sets of effects are about as likely as its own (1.6 % of draws): go by",
        ),
        ((0.4, 0.3), "Another set of effects is about as likely as its own (41 % of draws): go by"),
        ((0.4, 0.1), "Its set of effects is the likeliest (41 % of draws)"),
        ((0.6, 0.3), ""),
    ],
)
def test_an_extended_model_comes_with_how_many_sets_are_about_as_likely(
    probabilities: tuple[float, ...], said: str
) -> None:
    first, *others = probabilities
    sets = [Named(("gust",), first, 0.006, {}, {}), *(Named(("gust", "payload"), p, 0.002, {}, {}) for p in others)]
    answer: Any = SimpleNamespace(
        explanations=sets, effects={"gust": 0.9}, fit={"accepted": True, "accepted_because": "it gains"},
    )  # fmt: skip
    line = _proof(answer, trusted=True)
    assert said in line
    assert ("averaged over all sets" in line) == bool(said)
    assert "(probability" not in line


@pytest.mark.parametrize(("p_unknown", "said"), [(0.52, TOO_SMALL), (0.4, "")])
def test_something_unknown_that_no_force_or_sensor_shows_has_its_line(p_unknown: float, said: str) -> None:
    answer: Any = SimpleNamespace(unknown=None, p_unknown=p_unknown)
    assert _left(answer) == said
    for bound, longer in ((0.3, "[0.15,1.2]"), (1.2, "[0.3,1.5]")):
        answer.unknown = Unknown((), [], [Outgrown({"mu": HALF}, {"mu": (0.3, 1.2)}, (), 0.6, {"mu": bound})], None)
        assert [*_shown(answer)] == [said] * bool(said)
        assert "mu would leave the prior" in _left(answer)
        assert f"'prior.mu={longer}'" in _left(answer)


@pytest.mark.parametrize(
    ("probability", "std", "said"), [(0.45, 0.1, "perhaps"), (0.6, 0.3, "perhaps"), (0.6, 0.1, "force along x of 0.5")]
)
def test_what_is_left_over_has_a_place_where_that_is_likely_and_its_size_is_sure(
    probability: float, std: float, said: str
) -> None:
    size = Estimate(0.5, std, 0.4, 0.6, "N")
    law: Any = SimpleNamespace(target="force along x", signal="a_x", size=size, share=0.2, probability=probability)
    answer: Any = SimpleNamespace(unknown=SimpleNamespace(laws=[law], over_time=SimpleNamespace(within=[])))
    (line,) = _shown(answer)
    assert line.startswith("Left over: ")
    assert said in line


def test_a_parameter_at_a_bound_comes_with_the_words_that_widen_its_box() -> None:
    found = [("mu", (0.3, 1.2), 1.19), ("C_alpha_r", (5e4, 5e5), 5.1e4), ("steering_offset.angle", (-0.02, 0.04), 0.0)]
    said = widen(found)
    assert "'prior.mu=[0.3,1.5]'" in said
    assert "'prior.C_alpha_r=[25000,500000]'" in said  # half of it, as it cannot be negative
    assert "'prior.steering_offset.angle=[-0.04,0.04]'" in said
    for word in re.findall(r"'([^']*)'", said):
        name, _, box = word.removeprefix("prior.").partition("=")
        low, high = yaml.safe_load(box)
        at, box_before = next((at, before) for one, before, at in found if one == name)
        assert low <= box_before[0] < at < box_before[1] <= high
        assert high - low > box_before[1] - box_before[0]


def test_an_effect_is_there_if_any_of_its_sizes_is_and_a_profile_as_a_whole() -> None:
    names = ["imu_lever_arm.x", "imu_lever_arm.y", *(f"road_grade_profile.angle_{i}" for i in range(12))]
    sizes = tuple(EFFECT_PARAMETERS[name] for name in names)
    rates = np.array([0.5, 0.2, *[0.3] * 12])
    expanded = Expansion((), sizes, (), np.ones(len(sizes)), rates)
    assert expanded.probabilities == pytest.approx({"imu_lever_arm": 0.6, "road_grade_profile": 0.3})
