"""Draws of a posterior, and of the prior cut down to where posteriors have mass: uniform there and nowhere else."""

import numpy as np
import pytest
import torch
from cars import PAPER
from sbi.inference import EnsemblePosterior
from sbi.inference.posteriors import DirectPosterior
from sbi.neural_nets.estimators.base import ConditionalDensityEstimator
from scipy.stats import beta, kstest, norm
from torch import Tensor, nn
from torch.distributions import Independent, Normal

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.prior import parameter_space
from vehicle_sbi.inference.proposal import (
    EXCLUDED_MASS,
    LEAST_SHARED,
    RADIUS,
    RESAMPLED_FROM,
    SUPPORT_SAMPLES,
    WALKERS,
    WIDENED,
    Neighbourhood,
    Support,
    acceptance,
    box,
    draw,
    inside,
    log_density,
    truncated_prior,
)

SPACE = parameter_space({"l_f": [1.0, 1.5], "delta_C_alpha_f": [-0.3, 0.3]}, vehicle=PAPER, model="single_track")


class Gaussian(ConditionalDensityEstimator):
    """A density with closed forms: independent Gaussians, whatever x."""

    def __init__(self, mean: list[float], std: list[float]) -> None:
        super().__init__(net=nn.Linear(1, 1), input_shape=torch.Size([2]), condition_shape=torch.Size([1]))
        self.law = Independent(Normal(torch.tensor(mean), torch.tensor(std)), 1)

    def log_prob(self, input: Tensor, condition: Tensor, **kwargs: object) -> Tensor:
        return self.law.log_prob(input)

    def loss(self, input: Tensor, condition: Tensor, **kwargs: object) -> Tensor:
        return -self.log_prob(input, condition)

    def sample(self, sample_shape: torch.Size, condition: Tensor, **kwargs: object) -> Tensor:
        return self.law.sample((*sample_shape, len(condition)))


def posterior(mean: list[float], std: list[float]) -> DirectPosterior:
    found = DirectPosterior(Gaussian(mean, std), box(SPACE))
    found.set_default_x(torch.zeros(1, 1))
    return found


INSIDE = posterior([1.25, 0.0], [0.02, 0.03])  # far from the prior's edges
AT_EDGE = posterior([1.5, 0.0], [0.05, 0.03])  # half of it outside
OUTSIDE = posterior([1.8, 0.0], [0.05, 0.1])  # six standard deviations outside


# The threshold is the density of one draw, at rank k of all: the mass beyond it is Beta distributed. These are the
# masses that it falls short of, and exceeds, once in a million.
_RANK = round(EXCLUDED_MASS * SUPPORT_SAMPLES) + 1
MASS_BEYOND = beta(_RANK, SUPPORT_SAMPLES + 1 - _RANK).ppf([1e-6, 1 - 1e-6])


WELL_INSIDE = 3.3 * WIDENED  # radius [standard deviations] that every support reaches beyond


@pytest.fixture(autouse=True)
def seeded() -> None:
    torch.manual_seed(0)


@pytest.mark.parametrize(("of", "share"), [(INSIDE, 1.0), (AT_EDGE, 0.5), (OUTSIDE, 0.0)])
def test_acceptance_is_the_mass_inside_the_prior(of: DirectPosterior, share: float) -> None:
    assert abs(acceptance(of, SPACE) - share) <= 5 * np.sqrt(share * (1 - share) / 10_000)


def test_draws_are_the_density_cut_off_by_the_prior() -> None:
    samples = draw(AT_EDGE, SPACE, 5000)
    assert samples.shape == (5000, 2)
    assert (samples <= SPACE.high).all()
    assert (samples >= SPACE.low).all()
    assert kstest((1.5 - samples[:, 0]) / 0.05, "halfnorm").pvalue > 1e-3
    assert kstest(samples[:, 1] / 0.03, "norm").pvalue > 1e-3


def test_draws_of_a_density_outside_the_prior_end_and_lie_inside() -> None:
    """Six standard deviations out: rejection would take 1e9 draws; what is left of it crowds the edge."""
    samples = draw(OUTSIDE, SPACE, 500)
    assert samples.shape == (500, 2)
    assert (samples <= SPACE.high).all()
    # Beyond z = 6 the mean is that of the cut Gaussian (inverse Mills ratio), its standard error that of 500 draws and
    # of the candidates they are resampled from: N of them, uniform over the box, count as N (E w)^2 / E w^2, where
    # weights w fall off as exp(-6 z) in l_f, of width 10, and as a Gaussian of standard deviation 1/6 of the box.
    mean = norm.pdf(6) / norm.sf(6)
    std = np.sqrt(1 + 6 * mean - mean**2)
    candidates = RESAMPLED_FROM * 2 / 6 / 10 * 2 * np.sqrt(np.pi) / 6
    off = np.mean((1.8 - samples[:, 0]) / 0.05) - mean
    assert abs(off) < 5 * std * np.sqrt(1 / 500 + 1 / candidates)


def test_an_ensemble_is_the_mixture_of_its_members_in_random_order() -> None:
    other = posterior([1.1, 0.1], [0.02, 0.03])
    both = EnsemblePosterior([INSIDE, other]).set_default_x(torch.zeros(1, 1))
    samples = draw(both, SPACE, 4000)
    first = samples[:, 0] > 1.175
    assert abs(first.mean() - 0.5) < 5 * 0.5 / np.sqrt(4000)
    assert abs(first[:2000].mean() - 0.5) < 5 * 0.5 / np.sqrt(2000)
    theta = np.array([[1.25, 0.0], [1.1, 0.1]])
    expected = np.logaddexp(log_density(INSIDE, theta), log_density(other, theta)) - np.log(2)
    np.testing.assert_allclose(log_density(both, theta), expected, rtol=1e-5)


def test_the_density_is_nothing_outside_the_prior() -> None:
    assert log_density(AT_EDGE, np.array([[1.51, 0.0]]))[0] == -np.inf


def radius(theta: np.ndarray, mean: list[float], std: list[float]) -> np.ndarray:
    return np.hypot(*((theta - mean) / std).T)


def test_the_support_of_a_gaussian_is_its_ellipse_and_a_margin() -> None:
    """Of two dimensions exp(-r^2/2) of the mass lies beyond radius r, which is then widened.

    The peak is that of the draws: the nearest of n is farther than r with probability exp(-n r^2/2), once in a million
    beyond r^2 = 28/n, by which the widened square falls short at most.
    """
    support = Support.of(INSIDE, SPACE)
    most, least = WIDENED * np.sqrt(-2 * np.log(MASS_BEYOND))
    least = np.sqrt(least**2 - (WIDENED**2 - 1) * 28 / SUPPORT_SAMPLES)
    theta = np.random.default_rng(0).uniform([1.1, -0.2], [1.4, 0.2], (5000, 2))
    r = radius(theta, [1.25, 0.0], [0.02, 0.03])
    inner = support.contains(theta)
    assert inner[r < least].all()
    assert not inner[r > most].any()


def test_the_truncated_prior_is_uniform_on_the_support() -> None:
    support = Support.of(INSIDE, SPACE)
    theta = truncated_prior(SPACE, [support], 20_000, np.random.default_rng(1))
    assert theta.shape == (20_000, 2)
    assert support.contains(theta).all()
    r = radius(theta, [1.25, 0.0], [0.02, 0.03])
    # Uniform on a disc: r^2 is uniform, up to the corner that the box of the samples' range may cut off.
    inner = r[r < WELL_INSIDE]
    assert kstest((inner / WELL_INSIDE) ** 2, "uniform").pvalue > 1e-3
    angle = np.arctan2(theta[:, 1] / 0.03, (theta[:, 0] - 1.25) / 0.02)[r < WELL_INSIDE]
    assert kstest(angle, "uniform", (-np.pi, 2 * np.pi)).pvalue > 1e-3


def test_the_truncated_prior_ends_where_the_prior_does() -> None:
    support = Support.of(AT_EDGE, SPACE)
    theta = truncated_prior(SPACE, [support], 5000, np.random.default_rng(2))
    assert (theta <= SPACE.high).all()
    z = (1.5 - theta[:, 0]) / 0.05
    low = theta[(np.abs(theta[:, 1]) < 0.03) & (z < 2.5)]
    assert kstest((1.5 - low[:, 0]) / 0.05 / 2.5, "uniform").pvalue > 1e-3


def test_several_supports_are_cut_with_each_other() -> None:
    supports = [Support.of(posterior([mean, 0.0], [0.02, 0.03]), SPACE) for mean in (1.22, 1.28)]
    theta = truncated_prior(SPACE, supports, 3000, np.random.default_rng(3))
    assert inside(supports, theta).all()
    assert all(support.contains(theta).all() for support in supports)
    # The same set in the other order, though the box is then another's.
    swapped = truncated_prior(SPACE, supports[::-1], 3000, np.random.default_rng(4))
    for column in range(2):
        assert kstest(theta[:, column], swapped[:, column]).pvalue > 1e-3


def test_without_a_support_it_is_the_prior() -> None:
    theta = truncated_prior(SPACE, (), 5000, np.random.default_rng(5))
    for column in range(2):
        width = SPACE.high[column] - SPACE.low[column]
        assert kstest(theta[:, column], "uniform", (SPACE.low[column], width)).pvalue > 1e-3
    assert inside((), theta).all()


def test_a_thin_diagonal_support_is_sampled_uniformly_too() -> None:
    """Whatever its scale and direction: in the ellipse's own coordinates r^2 is uniform again."""

    class Correlated(Gaussian):
        def __init__(self) -> None:
            super().__init__([1.25, 0.0], [0.05, 0.05])
            covariance = 0.05**2 * torch.tensor([[1.0, 0.999], [0.999, 1.0]])
            self.law = torch.distributions.MultivariateNormal(torch.tensor([1.25, 0.0]), covariance)

    thin = DirectPosterior(Correlated(), box(SPACE))
    thin.set_default_x(torch.zeros(1, 1))
    support = Support.of(thin, SPACE)
    theta = truncated_prior(SPACE, [support], 5000, np.random.default_rng(6))
    assert support.contains(theta).all()
    z = np.linalg.solve(np.linalg.cholesky(0.05**2 * np.array([[1.0, 0.999], [0.999, 1.0]])), (theta - [1.25, 0.0]).T)
    r = np.hypot(*z)
    assert kstest((r[r < WELL_INSIDE] / WELL_INSIDE) ** 2, "uniform").pvalue > 1e-3


def test_a_support_of_one_parameter_is_an_interval() -> None:
    line = parameter_space({"l_f": [1.0, 1.5]}, vehicle=PAPER, model="single_track")

    class Line(Gaussian):
        def __init__(self) -> None:
            super().__init__([1.25], [0.02])
            self._input_shape = torch.Size([1])

    support = Support.of(DirectPosterior(Line(), box(line)).set_default_x(torch.zeros(1, 1)), line)
    theta = truncated_prior(line, [support], 2000, np.random.default_rng(7))
    assert theta.shape == (2000, 1)
    most, least = WIDENED * norm.isf(MASS_BEYOND / 2)
    r = np.abs(theta - 1.25) / 0.02
    assert r.max() < most
    # Of n uniform draws none lies in the outer share s of the interval with probability (1 - s)^n, here 1e-6.
    assert r.max() > least * 1e-6 ** (1 / len(theta))


def test_the_neighbourhood_of_a_fit_is_an_ellipse_that_is_proposed_from_uniformly() -> None:
    covariance = 0.01**2 * np.array([[1.0, 0.9], [0.9, 2.0]])
    around = Neighbourhood(np.array([1.25, 0.0]), covariance)
    theta = truncated_prior(SPACE, [around], 5000, np.random.default_rng(9))
    r = np.hypot(*np.linalg.solve(np.linalg.cholesky(covariance), (theta - around.mean).T))
    np.testing.assert_allclose(r, around.distance(theta))
    assert around.contains(theta).all()
    assert kstest((r / RADIUS) ** 2, "uniform").pvalue > 1e-3


def test_draws_follow_torchs_seed() -> None:
    def drawn(seed: int) -> np.ndarray:
        torch.manual_seed(seed)
        return draw(INSIDE, SPACE, 50)

    np.testing.assert_array_equal(drawn(1), drawn(1))
    assert (drawn(1) != drawn(2)).any()


def test_supports_that_do_not_meet_are_refused() -> None:
    supports = [Support.of(posterior([mean, 0.0], [0.005, 0.005]), SPACE) for mean in (1.1, 1.4)]
    with pytest.raises(InputError, match="rounds contradict each other: only"):
        truncated_prior(SPACE, supports, 10, np.random.default_rng(8))


def test_supports_that_meet_a_little_are_proposed_from_where_they_meet() -> None:
    """Fewer shared draws than walkers: some begin at the same place, and fill the region as evenly as others do."""
    around = [Neighbourhood(np.array([x, 0.0]), 0.01**2 * np.eye(2)) for x in (1.2, 1.33)]
    shared = inside(around, around[-1].draws(SPACE, np.random.default_rng(3))[0]).sum()
    assert LEAST_SHARED < shared < WALKERS
    theta = truncated_prior(SPACE, around, 5000, np.random.default_rng(4))
    assert inside(around, theta).all()
    even = SPACE.low + np.random.default_rng(5).uniform(size=(400_000, 2)) * (SPACE.high - SPACE.low)
    even = even[inside(around, even)]
    for column in range(2):
        assert kstest(theta[::5, column], even[:, column]).pvalue > 1e-3
