"""What may act unasked: all that can and is not spoken for; and what it costs is said."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from studies import simulator
from test_study import study

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.inference.features import Score
from vehicle_sbi.inference.information import bound_std, fisher
from vehicle_sbi.inference.plausible import PLAUSIBLE, plausible, sentence
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.inference.spike_slab import Slab, SpikeAndSlab
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.report.results import posterior_table
from vehicle_sbi.report.tables.posterior import WIDENED
from vehicle_sbi.report.tables.text import for_people

PRIOR = EffectPrior(table={"friction_level": {"rear": [0.05, 0.1]}, "aero_drag": {"area": [0.4, 0.65]}})
MIDDLE = np.array([1.25, 0.05, -0.1])


@cache
def found() -> SpikeAndSlab:
    return plausible(simulator(), PRIOR)


def test_no_plausible_effect_is_tied_to_the_clock_and_each_moves_the_series() -> None:
    free = found()
    sim = replace(simulator(), plausible=free)
    assert not any(CATALOGUE[name].timed for name in free.effects)
    for i in range(len(free)):
        eta = np.zeros((2, len(free)))
        eta[1, i] = np.where(free.high[i] > -free.low[i], free.high[i], free.low[i])
        still, moved = sim.noise_free(np.tile(MIDDLE, (2, 1)), eta)
        assert not np.array_equal(still, moved), free.slabs[i].parameter.name


def test_rates_and_sizes_are_those_of_the_prior_and_what_it_lists_has_a_slab_of_its_own() -> None:
    """The rear's grip acts only together with the front's here; how late the body rolls is not listed: its shape."""
    free = {slab.parameter.name: slab for slab in found().slabs}
    assert (free["aero_drag.area"].rate, free["aero_drag.area"].size) == (0.4, 0.65)
    assert (free["friction_level.rear"].rate, free["friction_level.rear"].size) == (0.05, 0.1)
    assert "body_roll.lag" not in free
    assert [p.name for p in free["body_roll.gradient"].shape] == ["body_roll.lag", "body_roll.period"]


def test_what_the_prior_names_is_not_drawn() -> None:
    """Neither what is inferred nor what it takes out by a null."""
    prior: dict[str, Any] = {"l_f": [1.0, 1.5], "aero_drag": {"area": [0.0, 1.5]}, "road_bank": {"angle": None}}
    problem = study(prior=prior, effects=PLAUSIBLE, effect_prior=PRIOR, truth=None).prepare().problem
    free = problem.simulator.plausible
    assert problem.simulator.space.names == ("l_f", "aero_drag.area")
    assert not {"aero_drag", "road_bank"} & set(free.effects)
    assert "road_grade" in free.effects
    assert problem.neighbourhood == ()
    said = sentence(free)
    assert said.startswith(f"{len(free.effects)} plausible effects were free, {len(free)} parameters drawn anew")
    assert all(name in said for name in free.effects)


def narrowed() -> Simulator:
    """A few of the slabs, without looking for them."""
    names = ("steering_ratio.gain", "accelerometer_bias.y", "imu_lever_arm.x", "steering_delay.time")
    parameters = [EFFECT_PARAMETERS[name] for name in names]
    slabs = tuple(Slab(parameter=p, rate=0.3, size=PRIOR.size_of(p)) for p in parameters)
    return replace(simulator(), plausible=SpikeAndSlab(slabs))


def test_the_bound_with_plausible_effects_is_the_wider_and_the_table_says_by_how_much() -> None:
    sim = narrowed()
    space = sim.space
    alone, bound = (bound_std(fisher(one, MIDDLE), space.prior_std) for one in (sim.alone, sim))
    assert (bound >= alone * (1 - 1e-9)).all()
    assert bound[0] > alone[0]
    samples = MIDDLE + 0.01 * np.random.default_rng(0).standard_normal((200, 3))
    table = posterior_table(space, samples, bound_std=bound, bound_std_alone=alone)
    np.testing.assert_allclose(table[list(WIDENED)], np.stack([alone, bound / alone, table["std"] / alone], axis=1))
    people = for_people(table)
    assert {"bound wider by", "std / bound without effects"} <= set(people)
    assert not {"bound wider by"} & set(for_people(table[[c for c in table if c not in WIDENED]]))


@pytest.mark.parametrize("nuisances", [True, False])
def test_features_with_plausible_effects(nuisances: bool) -> None:
    """As many as parameters where hardened alone; beside them those of each effect that the series tells apart."""
    sim = narrowed()
    y = sim.noise_free(MIDDLE[None])
    x = Score(nuisances=nuisances).fit(sim, MIDDLE, MIDDLE[None], y)(y)
    assert x.shape == (1, 7 if nuisances else 3)
    # At the fiducial nothing is left over: parameters in prior standard deviations, effects at their null.
    np.testing.assert_allclose(x[0], [*(MIDDLE / sim.space.prior_std), *np.zeros(x.shape[1] - 3)], atol=1e-4)


@pytest.mark.parametrize("effects", ["aero_drag", 3, None])
def test_what_is_no_list_of_effects_is_one_clear_line(effects: Any) -> None:
    with pytest.raises(InputError, match=f"effects = {effects}; it must be a list, as in .*, or plausible"):
        study(effects=effects)
