"""What sets in at a moment and stays: its evidence is an integral, its moment and size are found, and it is unknown."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded
from scipy.integrate import quad

from vehicle_sbi.inference.directions import left_out, tile
from vehicle_sbi.mismatch.answer.schema import Estimate, Followed
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.linearised import Linearised, profile
from vehicle_sbi.mismatch.explain import explain
from vehicle_sbi.mismatch.hypotheses.block import Stretch, clock
from vehicle_sbi.mismatch.hypotheses.regressor import Law, followed, targets, under
from vehicle_sbi.mismatch.onset import FINER, Onset, at, changes, moments, onsets, refined
from vehicle_sbi.mismatch.problem.observation import Observation

MOMENT = "moment about z"
SETS_IN, SIZE = 7.9, 400.0  # [s], [N m]


def dragging(size: float = SIZE) -> Observation:
    """A moment about z from a moment on, at none of those that are tried."""
    sim = lateral(seconds=20.0)
    clean = recorded(sim)
    target = next(t for t in targets(sim, clean.observed) if t.name == MOMENT)
    t = clock(sim)
    law = Law(target, "later", (t >= SETS_IN).astype(float).reshape(sim.windows.t.shape))
    both = followed(under(sim, law), law).noise_free(np.array([[*TRUTH, 0.0], [*TRUTH, size]]))
    return replace(clean, observed=clean.observed + both[1] - both[0])


@pytest.fixture(scope="module")
def fit() -> Fit:
    return fitted(dragging())


def of_moment(fit: Fit) -> Onset:
    return next(one for one in onsets(Linearised.of(fit)) if one.target.name == MOMENT)


def test_its_moment_and_its_size_are_found(fit: Fit) -> None:
    found = of_moment(fit)
    assert max(onsets(Linearised.of(fit)), key=lambda one: one.gain).gain == found.gain
    spacing = 0.5 * tile(fit.simulator) / FINER
    assert abs(found.start_s - SETS_IN) <= 3.0 * found.start_std
    assert spacing / np.sqrt(12.0) < found.start_std < tile(fit.simulator)
    late = spacing / (20.0 - SETS_IN)  # of its time, by which it may be smaller or larger
    assert found.size == pytest.approx(SIZE, abs=4.0 * found.std + late * SIZE)
    assert [one.to_s for one in found.within] == pytest.approx([20.0], abs=0.02)
    assert found.within[0].from_s == pytest.approx(found.start_s, abs=0.02)


def test_its_evidence_is_the_integral_over_size_and_the_mean_over_moments(fit: Fit) -> None:
    about, found = Linearised.of(fit), of_moment(fit)
    target = found.target
    low, high = target.size.low, target.size.high
    near = [max(low, found.size - 30.0 * found.std), min(high, found.size + 30.0 * found.std)]

    def evidence(change: np.ndarray) -> float:
        def density(a: float) -> float:
            there = profile(about, change[None, None], np.array([[a]]), np.array([[a]])).log_likelihood[0]
            return float(np.exp(there - about.alone - found.gain)) / (high - low)

        return quad(density, near[0], near[1], points=[found.size], epsrel=1e-6, limit=200)[0]

    half = 0.5 * tile(fit.simulator)
    starts = np.arange(7.7, 8.1, half / 40.0)  # a few samples farther there is nothing
    whole = len(moments(fit.simulator)) * half
    integral = np.sum([evidence(change) for change in changes(fit, target, starts)]) * half / 40.0 / whole
    # Laplace's approximation of a likelihood to the power of N/2 (gain^2 / N, as in test_loose), and moments a tenth of
    # a cell apart, between which a peak as narrow as one of them may rise by half of what it falls.
    fine = refined(about, target, at(about, target, moments(fit.simulator)))
    narrow = np.abs(np.diff(np.sort(fine.evidence)[-2:]))[0]
    assert np.log(integral) == pytest.approx(0.0, abs=found.gain**2 / 6000 + 0.5 * narrow + 0.02)


def test_what_sets_in_is_unknown_and_says_when(fit: Fit) -> None:
    near = [d for d in left_out(fit.simulator, fit.theta) if d.effect in ("gust", "steering_offset", "yaw_moment")]
    found = explain(fit, near, rng=np.random.default_rng(0))  # a gust before it beside an offset does nearly the same
    assert found.p_unknown > 0.5
    outside = found.unnamed[0].outside
    assert isinstance(outside, Onset)
    assert outside.start_s == pytest.approx(SETS_IN, abs=tile(fit.simulator) / FINER)


def test_its_moment_is_said_with_its_uncertainty() -> None:
    size, within = Estimate(400.0, 10.0, 383.6, 416.4, "N m"), [Stretch("a", 7.9, 20.0)]
    said = Followed(MOMENT, "sets in and stays", size, (), 0.9, within, 0.05).sentence
    assert said.endswith(f"{MOMENT} that sets in and stays, 400 ± 10 N m from 7.9 to 20.0 s of a (it begins ± 0.05 s).")


def test_what_is_there_from_the_beginning_has_not_set_in() -> None:
    steady = fitted(recorded(lateral(seconds=20.0), yaw_moment__moment=SIZE))
    known = next(t for t in targets(steady.simulator, steady.at.y) if t.name == MOMENT)
    always = changes(steady, known, np.array([0.0]))
    bounds = np.array([[known.size.low]]), np.array([[known.size.high]])
    about = Linearised.of(steady)
    throughout = profile(about, always[:, None], *bounds).log_likelihood[0] - about.alone
    assert throughout > 20.0
    assert of_moment(steady).gain < throughout


def test_without_any_change_there_is_none() -> None:
    # Of noise alone no target gains more than chance: e^gain has a mean of 1 over recordings (a ratio of evidences).
    found = [
        np.exp(one.gain) for seed in range(8) for one in onsets(Linearised.of(fitted(recorded(lateral(), seed=seed))))
    ]
    assert np.mean(found) < 1.0 + 4.0 * np.std(found) / np.sqrt(len(found))
