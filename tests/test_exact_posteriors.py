"""The long chains that posteriors are held against follow the law they are told."""

import emcee
import numpy as np
from estimators import MOVES, WALKERS

SCALES = np.array([0.008, 0.12, 0.04, 0.075, 0.026, 0.026, 0.05])  # as unequal as parameters of the paper's study
STEPS, WARM_UP = 2500, 500


def test_walkers_are_as_wide_as_a_normal() -> None:
    """Standard deviations within three standard errors, by the effective sample size of squares (half that of
    draws)."""

    def log_density(q: np.ndarray) -> np.ndarray:
        return -0.5 * ((q / SCALES) ** 2).sum(axis=1)

    start = SCALES * np.random.default_rng(0).standard_normal((WALKERS, len(SCALES)))
    sampler = emcee.EnsembleSampler(WALKERS, len(SCALES), log_density, vectorize=True, moves=MOVES)
    sampler.random_state = np.random.RandomState(0).get_state()
    sampler.run_mcmc(start, STEPS)
    q = np.asarray(sampler.get_chain(discard=WARM_UP))
    squares = (q / SCALES) ** 2
    effective = squares.size / len(SCALES) / emcee.autocorr.integrated_time(squares, quiet=True)
    np.testing.assert_array_less(np.abs(squares.mean(axis=(0, 1)) - 1.0), 3.0 * np.sqrt(2.0 / effective))
