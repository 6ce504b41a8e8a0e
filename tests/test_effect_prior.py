"""What is believed of missing physics: what is stated, what is not, and what is refused."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import yaml

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.physics.size import size_of

FILE = Path(__file__).resolve().parent.parent / "conf" / "effect_prior" / "passenger_car.yaml"
DELAY, FORCE = EFFECT_PARAMETERS["steering_delay.time"], EFFECT_PARAMETERS["crosswind.force"]


def stated() -> EffectPrior:
    """The file's own prior."""
    table = yaml.safe_load(FILE.read_text())["table"]
    return EffectPrior(table={e: {k: [float(x) for x in v] for k, v in of.items()} for e, of in table.items()})


def test_every_effect_is_stated_but_the_profile_over_time() -> None:
    assert CATALOGUE.keys() - stated().table.keys() == {"road_grade_profile"}


def test_every_typical_size_lies_in_the_box() -> None:
    prior = stated()
    for effect, entries in prior.table.items():
        for key in entries:
            p = EFFECT_PARAMETERS[f"{effect}.{key}"]
            assert prior.size_of(p) <= max(p.high - (p.null or 0.0), (p.null or 0.0) - p.low), p.name


def test_what_is_not_stated_has_the_common_rate_and_a_share_of_its_box() -> None:
    prior = EffectPrior(rate=0.2, share=0.25)
    assert prior.rate_of(DELAY) == 0.2
    assert prior.size_of(DELAY) == pytest.approx(0.25 * DELAY.high)


def test_forces_scale_with_the_car_and_times_do_not() -> None:
    prior, model_car = stated(), size_of(1.6, 0.17)
    small = model_car.fitted(FORCE)
    assert prior.size_of(small) / prior.size_of(FORCE) == pytest.approx(small.high / FORCE.high)
    assert prior.size_of(replace(DELAY, high=3.0)) == prior.size_of(DELAY)


@pytest.mark.parametrize(
    ("table", "line"),
    [
        ({"steering_dely": {"time": [0.4, 0.04]}}, "steering_dely"),
        ({"steering_delay": {"tim": [0.4, 0.04]}}, "tim"),
        ({"steering_delay": {"time": [1.0, 0.04]}}, "a rate lies between 0 and 1"),
        ({"steering_delay": {"time": [0.4, 0.0]}}, "a size is above 0"),
        ({"steering_delay": {"time": [0.4]}}, r"must be \[rate, size\]"),
        ({"steering_delay": {"time": "often"}}, r"must be \[rate, size\]"),
    ],
)
def test_a_wrong_entry_is_refused(table: Any, line: str) -> None:
    with pytest.raises(InputError, match=line):
        EffectPrior(table=table)
