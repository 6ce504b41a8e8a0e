"""What a verdict says in effects' names: which of them stand for each other."""

from vehicle_sbi.mismatch.verdict import exchangeable


def test_single_effects_that_fit_equally_well_are_one_group() -> None:
    assert exchangeable([("steering_lag",), ("sensor_lag",), ("steering_delay",)]) == [
        ["sensor_lag", "steering_delay", "steering_lag"]
    ]


def test_in_sets_what_is_exchanged_makes_the_groups() -> None:
    found = exchangeable(
        [("roll", "delay"), ("roll", "lag"), ("scale", "delay"), ("scale", "lag")]  # two choices of two
    )
    assert sorted(found) == [["delay", "lag"], ["roll", "scale"]]


def test_one_answer_and_unlike_answers_make_no_group() -> None:
    assert exchangeable([("roll",)]) == []
    assert exchangeable([("drag",), ("roll", "lag")]) == []
