"""The sampler of sets against all sets enumerated, and its parts against quadrature and closed forms."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid, quad
from scipy.special import logsumexp
from scipy.stats import kstest, norm

from vehicle_sbi import threads
from vehicle_sbi.mismatch.selection.coefficient import log_box, log_square, mostly_within, off_zero
from vehicle_sbi.mismatch.selection.gibbs import HELD, State, _drawn
from vehicle_sbi.mismatch.selection.inclusion import Chain, Groups, Shared, sample
from vehicle_sbi.mismatch.selection.inverse import factorise, set_precision
from vehicle_sbi.mismatch.selection.likeness import UNLIKE, likeness

SLABS = (0.6, 1.5)
SPIKE = 0.05
SHARED = Shared(missing=(0.1, 1.0), discrepant=(1.0,))


def problem(*, bounded: bool) -> tuple[np.ndarray, np.ndarray, Groups]:
    """A column that is always in, in a box, a shape of the second and fourth of five that may be missing, of which two
    are nearly the same, and a discrepancy of two columns that can stand for one of those."""
    rng = np.random.default_rng(3)
    X = rng.standard_normal((9, 60))
    X[4] = X[3] + 0.3 * rng.standard_normal(60)
    X[7:] = np.array([[0.6], [-0.5]]) * X[3] + 0.3 * X[7:]
    r = X.T @ np.array([1.0, 0.0, 0.0, 0.5, 0.0, 0.0, -0.3, 0.0, 0.0]) + rng.standard_normal(60)
    low, high = np.full(9, -np.inf), np.full(9, np.inf)
    low[0], high[0] = -1.0, 0.9
    if bounded:
        low[3:7], high[3:7] = [0.0, -0.5, -1.5, 0.0], [0.35, 0.0, 1.5, np.inf]
    groups = Groups(
        low=low,
        high=high,
        boxes=1,
        outside=0.1,
        start=2,
        stop=np.array([3, 4, 5, 6, 7, 9]),
        amplitude=np.tile([SPIKE, *SLABS], (6, 1)),
        share=np.tile([1.0, 0.7, 0.3], (6, 1)),
        rate=np.array([0.1, 0.3, 0.3, 0.3, 0.5, 0.4]),
        named=np.array([True, True, True, True, True, False]),
        shaped=np.array([[False, True, False, True, False, False]]),
    )
    return X @ X.T, X @ r, groups


def always(groups: Groups, level: np.ndarray) -> np.ndarray:
    """Precisions of what is in a box, and of shapes, which are held where nothing is there that they are of."""
    there = (groups.shaped & (level > 0)).any(axis=1)
    return np.concatenate([np.ones(groups.boxes), np.where(there, 1.0, HELD**-2)])


def enumerated(H: np.ndarray, b: np.ndarray, groups: Groups) -> np.ndarray:
    """Inclusion probabilities from every state, by the definition of its evidence."""
    weight, included = [], []
    start, widths = groups.start, np.diff([groups.start, *groups.stop])
    for level in itertools.product(range(3), repeat=len(widths)):
        sd = np.array([groups.amplitude[g, k] for g, k in enumerate(level)])
        precision = np.concatenate([always(groups, np.array(level)), np.repeat(sd**-2, widths)])
        A = H + np.diag(precision)
        mean, S = np.linalg.solve(A, b), np.linalg.inv(A)
        same = 0.5 * b @ mean - 0.5 * np.linalg.slogdet(A)[1] + 0.5 * np.log(precision).sum()
        same += log_box(mean[0], S[0, 0], groups.low[0], groups.high[0], groups.outside)
        for missing in SHARED.missing:
            log = same
            for g, k in enumerate(level):
                odds = groups.rate[g] / (1.0 - groups.rate[g]) * (missing if groups.named[g] else 1.0)
                log += (np.log(odds * groups.share[g, k]) if k else 0.0) - np.log1p(odds)
                j = start + g
                if k and groups.named[g]:
                    within = groups.low[j], groups.high[j]
                    log += log_square(mean[j], S[j, j], *within) - log_square(0.0, sd[g] ** 2, *within)
            weight.append(log)
            included.append(np.array(level) > 0)
    p = np.exp(np.array(weight) - logsumexp(weight))
    return p @ np.array(included)


@pytest.mark.parametrize("bounded", [False, True])
def test_inclusion_probabilities_are_those_of_all_sets_enumerated(bounded: bool) -> None:
    H, b, groups = problem(bounded=bounded)
    n = 4 * 2500
    found = sample(H, b, groups, SHARED, Chain(chains=4, sweeps=2600, forgotten=100, every=1), np.random.default_rng(0))
    exact = enumerated(H, b, groups)
    # Sweeps follow each other: a tenth of them count as independent at least, and five standard deviations are allowed.
    assert found.included.mean(axis=0) == pytest.approx(exact, abs=5.0 * 0.5 / np.sqrt(n / 10.0))


BOUNDS = [(-np.inf, np.inf), (0.0, np.inf), (-np.inf, 0.0), (0.0, 0.8), (-0.4, 0.0), (-1.0, 0.6), (0.0, 0.02)]


@pytest.mark.parametrize(("mean", "std"), [(0.5, 0.3), (-0.5, 0.3), (2.0, 0.5), (0.0, 1.0), (1.6, 0.1), (-1.4, 0.1)])
@pytest.mark.parametrize(("low", "high"), BOUNDS)
def test_weight_of_a_slab_is_the_mean_square_within_its_bounds(
    mean: float, std: float, low: float, high: float
) -> None:
    ends = max(low, mean - 12 * std), min(high, mean + 12 * std)
    exact = 0.0
    if ends[0] < ends[1]:
        # In parts about the mean: far from it the density falls by hundreds of decades.
        edges = np.unique(np.clip([*ends, mean, mean - 3 * std, mean + 3 * std, 0.0], *ends))
        parts = itertools.pairwise(edges)
        exact = sum(quad(lambda x: x**2 * float(norm.pdf(x, mean, std)), *e, epsabs=0.0)[0] for e in parts)
    if exact > 1e-30:
        assert log_square(mean, std**2, low, high) == pytest.approx(np.log(exact), abs=1e-6)
    else:
        assert log_square(mean, std**2, low, high) < -60.0


@pytest.mark.parametrize(("mean", "std"), [(0.0, 0.5), (1.5, 0.2), (40.0, 1e-3), (-2.0, 3.0)])
def test_weight_of_a_box_is_its_mass_and_no_less_than_the_probability_that_it_is_wrong(mean: float, std: float) -> None:
    within = norm.cdf(1.0, mean, std) - norm.cdf(-1.5, mean, std)
    assert log_box(mean, std**2, -1.5, 1.0, 0.01) == pytest.approx(np.log(0.99 * within + 0.01), abs=1e-12)


def test_weight_of_a_slab_far_on_the_wrong_side_joins_its_expansion() -> None:
    inside, beyond = (log_square(-z, 1.0, 0.0, np.inf) for z in (19.999, 20.001))
    assert inside == pytest.approx(beyond, abs=0.05)  # 0.04 from the step, 45 / z^4 from the expansion's next term
    assert beyond < inside


def test_coefficients_have_the_posterior_s_mean_and_spread() -> None:
    H, b, groups = problem(bounded=False)
    precision = np.ones(9)
    S = np.linalg.inv(H + np.diag(precision))
    m = S @ b
    state = State(np.zeros(0, dtype=np.int64), precision, S, m, np.zeros(9))
    endless = np.full(9, np.inf)
    believed = groups.believed._replace(low=-endless, high=endless)
    draws = np.array([_drawn(H, believed, state) for _ in range(4000)])
    std = np.sqrt(np.diag(S))
    assert np.abs(draws.mean(axis=0) - m) / std == pytest.approx(np.zeros(9), abs=5.0 / np.sqrt(4000))
    assert draws.std(axis=0) / std == pytest.approx(np.ones(9), abs=5.0 / np.sqrt(2 * 4000))


N = 20000
CRITICAL = 2.0 / np.sqrt(N)  # of Kolmogorov and Smirnov's distance, passed by chance once in 1500


def distance(draws: np.ndarray, density: Callable[[np.ndarray], np.ndarray], *, within: tuple[float, float]) -> float:
    """Kolmogorov and Smirnov's, from the law with a density that is integrated on a grid."""
    x = np.linspace(*within, 200001)
    cumulated = cumulative_trapezoid(density(x), x, initial=0.0)
    return float(kstest(draws, lambda at: np.interp(at, x, cumulated / cumulated[-1])).statistic)


@pytest.mark.parametrize(("low", "high"), BOUNDS)
@pytest.mark.parametrize(("mean", "std"), [(0.0, 1.0), (0.5, 0.3), (-0.5, 0.3), (2.0, 0.5), (-3.0, 0.5), (6.0, 0.3)])
def test_a_coefficient_in_a_slab_is_drawn_by_its_square_within_its_bounds(
    mean: float, std: float, low: float, high: float
) -> None:
    draws = np.array([off_zero(mean, std, low, high) for _ in range(N)])
    assert low <= draws.min()
    assert draws.max() <= high
    reach = abs(mean) + 9.0 * std
    within = max(low, -reach), min(high, reach)
    nearest = min(max(mean, within[0]), within[1])  # where the density is largest, against underflow

    def law(x: np.ndarray) -> np.ndarray:
        return x**2 * np.exp(0.5 * ((nearest - mean) ** 2 - (x - mean) ** 2) / std**2)

    assert distance(draws, law, within=within) < CRITICAL


@pytest.mark.parametrize(
    ("mean", "std"), [(0.0, 0.5), (0.9, 0.2), (1.3, 0.2), (0.0, 30.0), (4.0, 0.3), (-2.0, 0.2), (-1.9, 2.0)]
)
def test_a_base_parameter_is_drawn_within_its_box_unless_the_box_is_wrong(mean: float, std: float) -> None:
    draws = np.array([mostly_within(mean, std, -1.5, 1.0, 0.05) for _ in range(N)])

    def law(x: np.ndarray) -> np.ndarray:
        return norm.pdf(x, mean, std) * np.where((x > -1.5) & (x < 1.0), 1.0, 0.05)

    assert distance(draws, law, within=(mean - 9.0 * std, mean + 9.0 * std)) < CRITICAL


@pytest.mark.parametrize("upper", [np.inf, 0.3])
def test_coefficients_that_share_a_recording_are_drawn_from_their_joint_law(upper: float) -> None:
    # Two columns, one always there and bounded, one in a slab: moments of the law on a grid. Given the other, each
    # keeps 0.58 of where that is, so that ten draws of both forget where they start.
    H, m = np.array([[4.0, 3.2], [3.2, 4.0]]), np.array([0.9, 0.6])
    precision = np.array([1.0, 2.0])
    state = State(np.ones(1, np.int64), precision, np.linalg.inv(H + np.diag(precision)), m, np.array([0.0, 0.7]))
    groups = Groups(
        low=np.array([-1.0, -upper]), high=np.array([1.0, upper]), boxes=1, outside=0.01, start=1, stop=np.array([2]),
        amplitude=np.array([[0.1, 0.7]]), share=np.ones((1, 2)), rate=np.full(1, 0.5), named=np.ones(1, bool),
        shaped=np.zeros((0, 1), bool),
    )  # fmt: skip
    draws = np.array([_drawn(H, groups.believed, state) for _ in range(N)])
    x = np.stack(np.meshgrid(np.linspace(-4.0, 5.0, 901), np.linspace(-4.0, 5.0, 901), indexing="ij"))
    off = x - m[:, None, None]
    weight = np.exp(-0.5 * np.einsum("iab,ij,jab->ab", off, H + np.diag(precision), off)) * x[1] ** 2
    weight *= np.where(np.abs(x[0]) <= 1.0, 1.0, 0.01) * (np.abs(x[1]) <= upper)
    weight /= weight.sum()
    mean = np.sum(weight * x, axis=(1, 2))
    std = np.sqrt(np.sum(weight * (x - mean[:, None, None]) ** 2, axis=(1, 2)))
    assert (draws.mean(axis=0) - mean) / std == pytest.approx(np.zeros(2), abs=0.01 + 4.0 / np.sqrt(N))
    assert draws.std(axis=0) / std == pytest.approx(np.ones(2), abs=0.01 + 4.0 / np.sqrt(2 * N))


def test_means_are_those_of_the_normal_that_the_levels_give() -> None:
    # To a thousandth of a standard deviation, by which nothing that is said of them changes.
    H, b, groups = problem(bounded=True)
    found = sample(H, b, groups, SHARED, Chain(chains=2, sweeps=200, forgotten=50), np.random.default_rng(2))
    widths = np.diff([groups.start, *groups.stop])
    for level, mean in zip(found.level, found.mean, strict=True):
        amplitude = np.array([groups.amplitude[g, k] for g, k in enumerate(level)])
        precision = np.concatenate([always(groups, level), np.repeat(amplitude**-2, widths)])
        S = np.linalg.inv(H + np.diag(precision))
        assert np.all(np.abs(mean - S @ b) < 1e-3 * np.sqrt(np.diag(S)))


def test_coefficients_in_slabs_are_never_beyond_their_bounds() -> None:
    H, b, groups = problem(bounded=True)
    found = sample(H, b, groups, SHARED, Chain(chains=2, sweeps=300, forgotten=100), np.random.default_rng(1))
    for g in range(5):
        j = groups.start + g
        there = found.coefficient[found.included[:, g], j]
        assert np.all((groups.low[j] <= there) & (there <= groups.high[j]))


def test_what_is_hardly_told_apart_follows_a_coefficient_into_its_bounds() -> None:
    """Two columns of which only the sum is told: where one's bound is in the way of its mean, the other makes up for
    it, to within what is told of the sum."""
    H, b = np.array([[1e4, 0.999e4], [0.999e4, 1e4]]), np.array([2e4, 2e4])
    groups = Groups(
        low=np.array([-5.0, 0.0]), high=np.array([5.0, 0.5]), boxes=1, outside=1e-9, start=1, stop=np.array([2]),
        amplitude=np.array([[0.01, 1.5]]), share=np.ones((1, 2)), rate=np.full(1, 0.5), named=np.ones(1, bool),
        shaped=np.zeros((0, 1), bool),
    )  # fmt: skip
    found = sample(H, b, groups, SHARED, Chain(chains=2, sweeps=400, forgotten=100), np.random.default_rng(0))
    there = found.coefficient[found.included[:, 0]]
    assert len(there) > 50
    assert there[:, 1].max() <= 0.5
    # The sum is b / 0.9995e4 = 2.001 but for the prior's pull of 1 in 2e4, with a standard deviation of 0.005.
    np.testing.assert_allclose(there.sum(axis=1), 2.001, atol=6 * 0.00708)


def test_the_same_generator_gives_the_same_draws() -> None:
    H, b, groups = problem(bounded=False)
    one, other = (
        sample(H, b, groups, SHARED, Chain(chains=2, sweeps=60, forgotten=20), np.random.default_rng(5))
        for _ in range(2)
    )
    assert np.array_equal(one.coefficient, other.coefficient)


def test_a_thousand_changes_of_precisions_by_nine_decades_leave_the_inverse_as_it_is() -> None:
    # Groups of one column and of two, some of which the recording hardly shows. Where a precision falls by 9 decades,
    # what remains of it is known to the rounding of numbers times 1e9; a thousand such errors add up as their root.
    rel = 1000**0.5 * 1e9 * np.finfo(float).eps
    rng = np.random.default_rng(0)
    X = rng.standard_normal((12, 60)) * np.geomspace(1e-2, 30.0, 12)[:, None]
    H, b, precision = X @ X.T, X @ rng.standard_normal(60), np.ones(12)
    groups = [slice(2, 3), slice(3, 4), slice(4, 6), slice(6, 7), slice(7, 9), slice(9, 10), slice(10, 12)]
    S, m = np.empty((12, 12)), np.empty(12)
    factorise(H, b, precision, S, m)
    for _ in range(1000):
        one = groups[rng.integers(len(groups))]
        set_precision(one.start, one.stop, float(rng.choice([1e-1, 1.0, 1e3, 1e8])), precision, S, m)
        A = H + np.diag(precision)
        scale = np.sqrt(np.diag(A))
        exact = np.linalg.inv(A / np.outer(scale, scale)) / np.outer(scale, scale)
        assert np.diag(S) == pytest.approx(np.diag(exact), rel=rel)
        assert m == pytest.approx(exact @ b, rel=rel, abs=rel * np.abs(m).max())


def test_groups_are_as_alike_as_the_mean_squared_cosine_beside_what_is_always_there() -> None:
    # The first column is always there: of a long one nothing is left. Beside it the others have the angles below.
    cosine, rest = 0.8, 0.6
    X = np.zeros((6, 6))
    X[0, 0] = 1e4
    X[1, :2] = 3.0, 2.0
    X[2, :3] = -5.0, 7.0 * cosine, 7.0 * rest
    X[3, 3] = 1.0
    X[4, [1, 3]] = 1.0, 4.0  # with the row before a plane that holds row 1's direction
    X[5, 0] = 1.0  # taken over altogether
    found = likeness(X @ X.T, 1, 1, np.array([2, 3, 5, 6]))
    square, other = cosine**2, UNLIKE
    exact = [[1.0, square, 1.0, other], [square, 1.0, square, other], [1.0, square, 1.0, other]]
    assert found[:3] == pytest.approx(np.array(exact), abs=1e-6)  # 1e-8 of the first column's length stays in others
    assert found[3, :3] == pytest.approx(other)


def test_draws_are_the_same_on_however_many_threads_chains_run(monkeypatch: pytest.MonkeyPatch) -> None:
    H, b, groups = problem(bounded=True)
    few, found = Chain(chains=3, sweeps=20, forgotten=10, every=1), []
    for used in (1, 3):
        monkeypatch.setattr(threads, "_used", used)
        found.append(sample(H, b, groups, SHARED, few, np.random.default_rng(0)))
    np.testing.assert_array_equal(found[0].coefficient, found[1].coefficient)
    chains = np.split(found[0].coefficient, few.chains)
    assert not np.array_equal(chains[0], chains[2])  # which begin alike, with seeds of their own
