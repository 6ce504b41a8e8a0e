"""Whether posteriors are calibrated: how often their intervals hold truths that are drawn from the prior.

Draw theta* from the prior, simulate x with it, and draw theta_1, …, theta_L from the posterior at x. If that posterior
is exact, the rank of theta* among the draws is uniform on 0, …, L in every parameter (Talts et al. 2018, Validating
Bayesian inference algorithms with simulation-based calibration, theorem 1), and a central interval of level c holds the
share c of truths. Distances from random points are held against theirs in the same way by TARP (Lemos et al. 2023,
Sampling-based accuracy testing of posterior estimators for general inference), which sees correlations too. L-C2ST asks
a classifier about a single recording (Linhart et al. 2023, L-C2ST: local diagnostics for posterior approximations).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import numpy as np
from jaxtyping import Bool, Float, Int
from sbi.inference.posteriors.base_posterior import NeuralPosterior
from scipy.stats import binomtest, kstest
from torch import Tensor

LEVELS = (0.5, 0.8, 0.9)  # of the central intervals that are counted
JUDGED = 0.9  # the level whose count gives the verdict
ACCEPTED_FALSE = 0.05  # chance that any rank test of a calibrated study fails
REPEATED = "recordings"  # folder of a run that keeps whole studies
CONSISTENT, NARROW, WIDE = "consistent", "too narrow", "too wide"
PER_BIN = 10  # recordings in a bin of TARP's histogram, as sbi has it
LEAST_BINS = 4
TRIALS = 100  # of L-C2ST under its null hypothesis


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """Ranks of truths among `samples` draws of their posteriors, a row for each recording, and what else was tested.

    `c2st_ranks` is by parameter how well a classifier tells the ranks from uniform numbers (0.5: not at all), `joint`
    what was tested of all parameters together; both are of an amortised study alone.
    """

    names: tuple[str, ...]
    ranks: Int[np.ndarray, "n d"]
    samples: int
    c2st_ranks: Float[np.ndarray, " d"] | None = None
    joint: "Joint | None" = None
    notes: tuple[str, ...] = ()

    def held(self, level: float) -> Int[np.ndarray, " d"]:
        """How many truths the central intervals of a level hold, by parameter."""
        return within(self.ranks, self.samples, level).sum(axis=0)

    @property
    def ks_p(self) -> Float[np.ndarray, " d"]:
        """p-value by parameter of uniform ranks: the Kolmogorov-Smirnov test that sbi's check_sbc makes."""
        return np.array([kstest(column, "uniform", (0, self.samples)).pvalue for column in self.ranks.T])

    @property
    def uniform(self) -> Bool[np.ndarray, " d"]:
        """Whether the rank test passes, by parameter; of calibrated studies it fails for any one in twenty."""
        return self.ks_p >= ACCEPTED_FALSE / len(self.names)

    @property
    def verdicts(self) -> tuple[str, ...]:
        """By parameter, from the binomial interval of the 90 % intervals' count."""
        return tuple(verdict(*proportion(int(count), len(self.ranks))) for count in self.held(JUDGED))


@dataclass(frozen=True, kw_only=True)
class Joint:
    """Tests of all parameters at once: TARP's area to curve and p-value, L-C2ST's p-value at one recording, and by
    parameter how well a classifier tells the average of all posteriors from the prior (0.5: not at all)."""

    area: float
    tarp_p: float
    local_p: float
    average: Mapping[str, float]

    def sentences(self) -> tuple[str, ...]:
        """What they say, for the notes of a calibration."""
        name, farthest = max(self.average.items(), key=lambda pair: pair[1])
        return (
            f"TARP, all parameters at once: area to curve {self.area:+.3f} (below 0: too narrow or shifted; above: too "
            f"wide), p = {self.tarp_p:.2g}.",
            f"L-C2ST, at the study's own observation: p = {self.local_p:.2g}.",
            f"Average of all posteriors against the prior: of {name}, where it is easiest, a classifier tells "
            f"{farthest:.0%} apart (50% is chance).",
        )


def ranks(truth: Float[np.ndarray, " d"], draws: Float[np.ndarray, "samples d"]) -> Int[np.ndarray, " d"]:
    """How many draws of a posterior lie below the truth, by parameter: 0 to the number of draws."""
    return (draws < truth).sum(axis=0)


def within(ranks: Int[np.ndarray, "n d"], samples: int, level: float) -> Bool[np.ndarray, "n d"]:
    """Whether central intervals of a level hold the truths, told by their ranks.

    Of samples + 1 ranks that are equally likely those nearest the middle are inside: the share `level`, but for one
    rank.
    """
    return np.abs((ranks + 0.5) / (samples + 1) - 0.5) <= level / 2


def proportion(held: int, n: int) -> tuple[float, float]:
    """The 95 % interval of a share of which `held` of n were seen (Wilson 1927, J. Am. Stat. Assoc. 22, 209)."""
    found = binomtest(held, n).proportion_ci(confidence_level=0.95, method="wilson")
    return float(found.low), float(found.high)


def verdict(low: float, high: float, level: float = JUDGED) -> str:
    """What an interval of the share that is held says of intervals of a level."""
    if high < level:
        return NARROW
    return WIDE if low > level else CONSISTENT


@dataclass(frozen=True)
class Drawn:
    """Draws (samples, n, d) that stand in for a posterior at n recordings, so that all of sbi's tests see the same.

    sbi would draw by rejection, which need not end where most of a density lies outside the prior.
    """

    draws: Tensor

    def sample_batched(self, sample_shape: Sequence[int], x: Tensor, show_progress_bars: bool = False) -> Tensor:
        return self.draws


def by_sbi(
    names: Sequence[str],
    theta: Tensor,
    x: Tensor,
    draws: Tensor,
    *,
    local: tuple[Tensor, Tensor],
    seed: int,
    trials: int = TRIALS,
) -> Calibration:
    """sbi's SBC and TARP of draws (samples, n, d) at recordings x (n, …) of truths theta (n, d), and its L-C2ST.

    `local` is a recording x_o (1, …) and draws of its posterior, `trials` how many null classifiers L-C2ST is held
    against. Needs torch's generator seeded.
    """
    from sbi.diagnostics import check_sbc, check_tarp, run_sbc, run_tarp  # here, because it takes seconds to import

    posterior, samples = cast(NeuralPosterior, Drawn(draws)), len(draws)
    found, averaged = run_sbc(theta, x, posterior, num_posterior_samples=samples, show_progress_bar=False)
    checks = check_sbc(found, theta, averaged, num_posterior_samples=samples)
    bins = max(LEAST_BINS, len(theta) // PER_BIN)
    tarp = run_tarp(theta, x, posterior, num_posterior_samples=samples, show_progress_bar=False, num_bins=bins)
    area, tarp_p = check_tarp(*tarp)
    average = dict(zip(names, checks["c2st_dap"].tolist(), strict=True))
    local_p = _local((theta, x, averaged), local, seed, trials)
    return Calibration(
        names=tuple(names),
        ranks=found.long().numpy(),
        samples=samples,
        c2st_ranks=checks["c2st_ranks"].double().numpy(),
        joint=Joint(area=area, tarp_p=float(tarp_p), local_p=local_p, average=average),
    )


def _local(joint: tuple[Tensor, Tensor, Tensor], local: tuple[Tensor, Tensor], seed: int, trials: int) -> float:
    """p-value of L-C2ST at x_o; `joint` are truths (n, d), recordings (n, …) and a draw (n, d) of the posterior at
    each."""
    from sbi.diagnostics import LC2ST

    (theta, x, one_each), (x_o, draws) = joint, local
    test = LC2ST(
        prior_samples=theta,
        xs=x.flatten(1),
        posterior_samples=one_each,
        z_score=True,
        classifier_kwargs={"random_state": seed % 2**32},
        num_trials_null=trials,
    )
    test.train_on_observed_data(verbosity=0).train_under_null_hypothesis(verbosity=0)
    return test.p_value(theta_o=draws, x_o=x_o.flatten(1))
