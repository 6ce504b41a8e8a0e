"""A density in a box keeps its mass there, and its contours hold the mass they claim."""

import numpy as np
import pytest

from vehicle_sbi.report.density import density_in_box, level_of
from vehicle_sbi.report.figures import MASSES


def test_a_flat_posterior_is_drawn_flat_up_to_the_priors_bounds() -> None:
    """Mirrored kernels integrate to one over the box; the density of n uniform draws stays within its own noise."""
    low, high = np.array([0.2]), np.array([0.6])
    grid = np.linspace(0.2, 0.6, 401)
    drawn = np.random.default_rng(0).uniform(0.2, 0.6, (5000, 1))
    density = density_in_box(drawn, grid[:, None], low, high)
    assert np.trapezoid(density, grid) == pytest.approx(1.0, abs=1e-3)
    # var f = f / (2 sqrt(pi) n h), twice that at a mirrored edge; h = sigma n^(-1/5), Scott's rule
    h = drawn.std() * len(drawn) ** -0.2
    noise = np.sqrt(2.0 * 2.5 / (2.0 * np.sqrt(np.pi) * len(drawn) * h))
    np.testing.assert_allclose(density, 2.5, atol=5.0 * noise)


def test_contours_hold_the_mass_they_claim() -> None:
    x = np.linspace(-6.0, 6.0, 601)
    density = np.exp(-0.5 * (x[:, None] ** 2 + x[None] ** 2))
    for mass in MASSES:  # a 2-D normal holds `mass` where the density is above 1 - mass of its peak
        assert level_of(density, mass) == pytest.approx(1.0 - mass, abs=2e-3)
