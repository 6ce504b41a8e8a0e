"""Draws of what a car may have have the law that is stated, and are functions of their address."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import kstest, truncnorm
from studies import simulator

from vehicle_sbi.inference.information import sensitivity
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.inference.spike_slab import STEP, Slab, SpikeAndSlab
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS
from vehicle_sbi.rng import Stream

GAIN, DELAY = EFFECT_PARAMETERS["steering_ratio.gain"], EFFECT_PARAMETERS["steering_delay.time"]
FORCE, ARM = CATALOGUE["crosswind"].parameters
BIAS = Slab(parameter=EFFECT_PARAMETERS["accelerometer_bias.y"], rate=0.4, size=0.15)
FREE = SpikeAndSlab(
    (
        Slab(parameter=GAIN, rate=0.4, size=0.06),
        Slab(parameter=DELAY, rate=0.3, size=0.2),
        Slab(parameter=FORCE, rate=0.2, size=300.0, shape={ARM: 0.5}),
    )
)
N = 4000


def drawn() -> np.ndarray:
    rng = np.random.default_rng(0)
    return np.concatenate([FREE.sample(rng) for _ in range(N)])


def freed(free: SpikeAndSlab = FREE) -> Simulator:
    return replace(simulator(), plausible=free)


@pytest.mark.parametrize("i", range(3))
def test_a_parameter_stays_at_its_null_but_for_its_rate_and_leaves_it_by_a_normal_inside_its_box(i: int) -> None:
    """A delay, whose null is an edge of its box, leaves it to one side. Five standard errors of a share."""
    slab, x = FREE.slabs[i], drawn()[:, i]
    away, box = x[x != slab.null], slab.parameter
    assert np.mean(x != slab.null) == pytest.approx(slab.rate, abs=5 * np.sqrt(slab.rate * (1 - slab.rate) / N))
    assert ((box.low <= x) & (x <= box.high)).all()
    ends = [(end - slab.null) / slab.size for end in (box.low, box.high)]
    assert kstest(away, truncnorm(*ends, loc=slab.null, scale=slab.size).cdf).pvalue > 1e-3


def test_the_spread_is_the_root_mean_square_distance_from_the_null() -> None:
    """Of a wide box. The mean of x^4 is 3 rate size^4, so the mean square's relative error sqrt(3 / rate N)."""
    slab = FREE.slabs[0]
    square = np.mean((drawn()[:, 0] - slab.null) ** 2)
    assert square == pytest.approx(slab.spread**2, rel=5 * np.sqrt(3 / slab.rate / N))


def test_what_gives_an_effect_its_shape_is_uniform_where_the_effect_is_there() -> None:
    x = drawn()
    there = x[:, 2] != 0.0
    assert kstest(x[there, 3], "uniform", (ARM.low, ARM.high - ARM.low)).pvalue > 1e-3
    assert not x[~there, 3].any()


def test_draws_depend_on_their_address_alone() -> None:
    """Neither on the batch nor on the order."""
    sim, index = freed(), np.arange(24)
    theta = np.random.default_rng(0).uniform(sim.space.low, sim.space.high, (24, 3))

    def simulated(rows: np.ndarray) -> np.ndarray:
        return sim.simulate(theta[rows], index[rows], stream=Stream.SIMULATION)[0]

    whole, order = simulated(index), np.random.default_rng(1).permutation(24)
    np.testing.assert_array_equal(simulated(order), whole[order])
    np.testing.assert_array_equal(np.concatenate([simulated(part) for part in np.array_split(index, 5)]), whole)


def test_without_slabs_nothing_is_taken_from_the_generator() -> None:
    rng, untouched = np.random.default_rng(0), np.random.default_rng(0)
    assert SpikeAndSlab().sample(rng).shape == (1, 0)
    assert rng.random() == untouched.random()


def test_a_simulation_has_what_was_drawn() -> None:
    """A bias of the side acceleration adds what was drawn to it, and nothing to anything else."""
    sim = freed(SpikeAndSlab((BIAS,)))
    theta, eta = np.array([[1.25, 0.05, -0.1]]), np.array([[1.7]])
    moved = (sim.noise_free(theta, eta) - sim.alone.noise_free(theta))[0]
    expected = np.where(np.array(sim.windows.channels) == "a_y", 1.7 * BIAS.spread, 0.0)
    np.testing.assert_allclose(moved, np.broadcast_to(expected[:, None], moved.shape), atol=1e-12)


def test_derivatives_by_an_effect_stay_inside_its_box() -> None:
    """A delay's is to one side of its null; of a bias, which adds, it is what a unit of its spread adds."""
    delay, bias = FREE.slabs[1], BIAS
    sim, theta = freed(SpikeAndSlab((delay, bias))), np.array([1.25, 0.05, -0.1])
    at, step = sensitivity(sim, theta), STEP * delay.size / delay.spread
    still, later = sim.noise_free(np.tile(theta, (2, 1)), np.array([[0.0, 0.0], [step, 0.0]]))
    np.testing.assert_allclose(at.jacobian[3], (later - still) / step, rtol=1e-12, atol=1e-12)
    row = sim.windows.channels.index("a_y")
    np.testing.assert_allclose(at.jacobian[4, row], bias.spread, rtol=1e-9)
    assert not np.delete(at.jacobian[4], row, axis=0).any()


def test_distances_beyond_a_box_are_drawn_back_to_it() -> None:
    values = FREE.at(np.array([[-1e9] * 3, [1e9] * 3]))
    np.testing.assert_allclose(values, [[GAIN.low, 0.0, FORCE.low, 0.5], [GAIN.high, DELAY.high, FORCE.high, 0.5]])
