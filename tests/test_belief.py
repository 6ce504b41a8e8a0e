"""A prior over sets of effects is one, and nonsense in its place is refused."""

from math import comb, exp

import pytest

from vehicle_sbi.errors import InputError
from vehicle_sbi.mismatch.belief import Belief
from vehicle_sbi.physics.effects import CATALOGUE


@pytest.mark.parametrize("effects", [(0.5, 0.4, 0.09, 0.01), (0.2, 0.8)])
def test_all_sets_together_are_certain(effects: tuple[float, ...]) -> None:
    belief = Belief(effects=effects, unknown=0.5)
    total = sum(comb(len(CATALOGUE), n) * exp(belief.log_prior(n)) for n in range(belief.most + 1))
    assert total == pytest.approx(1.0, rel=1e-12)
    odds = sum(exp(belief.log_prior(1, 9) - belief.log_prior(1)) for _ in range(9))
    assert odds == pytest.approx(0.5 * 9 / 3, rel=1e-12)  # nine that are alike in groups count as three


@pytest.mark.parametrize(
    "given", [{"effects": [0.5, 0.6]}, {"effects": [1.0]}, {"effects": [1.2, -0.2]}, {"unknown": 0}, {"unknown": True}]
)
def test_what_is_no_belief_is_refused(given: dict) -> None:
    with pytest.raises(InputError, match="belief"):
        Belief(**given)
