"""Which effects are missing, by several methods on the same linear problems: the whole cars of a campaign.

python benchmarks/selectors_compared.py FOLDER NAME

FOLDER is one of `scripts/prove.py mix=whole_car`, NAME that of its diagnoses. Each problem is the expanded model, made
linear about the last fit of a diagnosis, of the recordings that were fitted. Methods:

    gibbs     spike and slab with discrepancies, as a diagnosis samples it
    alone     the same without discrepancies
    susie     the sum of ten single effects (Wang, Sarkar, Carbonetto and Stephens 2020), by its own iteration
    bic       forward selection by BIC

The last two have base parameters, shapes and discrepancies integrated out as normal.
"""

import json
import platform
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import date
from pathlib import Path

import numpy as np
import pandas as pd
from gathering import RESULTS
from jaxtyping import Float
from whole_car.page import calibration
from whole_car.scores import STRONG, standing

from vehicle_sbi.files import write_text
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.mismatch.answer.wording import NAMED
from vehicle_sbi.mismatch.estimation.linear_gaussian import LinearGaussian, linear_gaussian
from vehicle_sbi.mismatch.estimation.to_nulls import to_nulls
from vehicle_sbi.mismatch.hypotheses.dictionary import sources
from vehicle_sbi.mismatch.hypotheses.discrepancy import Discrepancy
from vehicle_sbi.mismatch.pipeline import AtOnce
from vehicle_sbi.mismatch.selection.expand_and_prune import groups_of
from vehicle_sbi.mismatch.selection.inclusion import Chain, Sampled, Shared, sample
from vehicle_sbi.mismatch.selection.pruned import Pruned
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.report.stage_file import read
from vehicle_sbi.report.tables.text import markdown

CHAIN = Chain(chains=2, sweeps=200, forgotten=80, every=2)
SINGLE_EFFECTS, ITERATIONS = 10, 50  # of SuSiE
NONE = 0.5  # prior weight of no effect in each of them
AMPLITUDE = 0.3  # of a discrepancy's coefficients, where they are integrated out as normal
Probabilities = Mapping[str, float]


@dataclass(frozen=True)
class Problem:
    """A case's linear problem, with what was found by the diagnosis itself."""

    pruned: Pruned
    off: Sequence[Discrepancy]
    linear: LinearGaussian
    prior: EffectPrior

    @property
    def names(self) -> list[str]:
        """The effect of each size."""
        return [p.name.split(".")[0] for p in self.pruned.expansion.sizes]

    @property
    def sizes(self) -> slice:
        """Where sizes are among the columns."""
        stop = len(self.pruned.expansion.unit)
        return slice(stop - len(self.pruned.expansion.sizes), stop)

    def of_effects(self, p: Float[np.ndarray, " sizes"]) -> Probabilities:
        """Of effects from those of their sizes, which are independent."""
        left: dict[str, float] = {}
        for name, one in zip(self.names, p, strict=True):
            left[name] = left.get(name, 1.0) * (1.0 - float(one))
        return {name: 1.0 - one for name, one in left.items()}


def problem(path: Path, prior: EffectPrior) -> Problem | None:
    """Of a diagnosis' folder, if it got so far."""
    pruned = read(path / "stages" / "pruned.npz", AtOnce).pruned
    if pruned is None:
        return None
    off = [one.about(pruned.fit) for one in sources(pruned.fit)]
    (about,) = to_nulls(pruned.expansion, [pruned.fit])
    return Problem(pruned, off, linear_gaussian(pruned.expansion, [(about, [d.whitened for d in off])]), prior)


def selected(given: Problem, *, discrepancy: float | None = None) -> Sampled:
    """Draws of the diagnosis' own sampler."""
    prior = given.prior if discrepancy is None else replace(given.prior, discrepancy=discrepancy)
    groups = groups_of(given.pruned.expansion, given.off, prior)
    return sample(given.linear.H, given.linear.b, groups, Shared(), CHAIN, np.random.default_rng(0))


def chances(given: Problem, drawn: Sampled) -> Probabilities:
    """The probability that each effect is missing, by draws."""
    sizes = np.repeat(drawn.included[:, : len(given.pruned.expansion.groups)], given.pruned.expansion.groups, axis=1)
    names = np.array(given.names)
    return {name: float(sizes[:, names == name].any(axis=1).mean()) for name in dict.fromkeys(given.names)}


def gibbs(given: Problem) -> Probabilities:
    return chances(given, selected(given))


def alone(given: Problem) -> Probabilities:
    return chances(given, selected(given, discrepancy=1e-6))


def _marginal(given: Problem) -> tuple[Float[np.ndarray, "k k"], Float[np.ndarray, " k"]]:
    """Information and score of the sizes, all else integrated out as normal."""
    H, b, ours = given.linear.H, given.linear.b, np.zeros(len(given.linear.b), dtype=bool)
    ours[given.sizes] = True
    precision = np.where(np.arange(len(b)) < given.sizes.stop, 1.0, (AMPLITUDE * given.prior.scale) ** -2.0)
    others = H[np.ix_(~ours, ~ours)] + np.diag(precision[~ours])
    taken = np.linalg.solve(others, np.column_stack([H[np.ix_(~ours, ours)], b[~ours]]))
    cross = H[np.ix_(ours, ~ours)]
    return H[np.ix_(ours, ours)] - cross @ taken[:, :-1], b[ours] - cross @ taken[:, -1]


def susie(given: Problem) -> Probabilities:
    S, v = _marginal(given)
    rates = given.pruned.expansion.rates
    weight = np.append((1.0 - NONE) * rates / rates.sum(), NONE)
    alpha, mean = np.zeros((SINGLE_EFFECTS, len(v) + 1)), np.zeros((SINGLE_EFFECTS, len(v)))
    information = np.maximum(np.diag(S), 1e-12)
    for _ in range(ITERATIONS):
        for k in range(SINGLE_EFFECTS):
            others = mean.sum(axis=0) - mean[k]
            score = v - S @ others
            log_bf = 0.5 * score**2 / (information + 1.0) - 0.5 * np.log1p(information)
            log_weight = np.append(log_bf, 0.0) + np.log(weight)
            alpha[k] = np.exp(log_weight - np.logaddexp.reduce(log_weight))
            mean[k] = alpha[k, :-1] * score / (information + 1.0)
    return given.of_effects(1.0 - np.prod(1.0 - alpha[:, :-1], axis=0))


def bic(given: Problem) -> Probabilities:
    S, v = _marginal(given)
    samples = float(given.pruned.fit.simulator.windows.valid.sum())
    chosen, best = list[int](), 0.0
    while True:
        tried = {k: _gain(S, v, [*chosen, k]) for k in range(len(v)) if k not in chosen}
        k = max(tried, key=lambda one: tried[one], default=-1)
        if k < 0 or 2.0 * (tried[k] - best) < np.log(samples):
            break
        chosen, best = [*chosen, k], tried[k]
    return given.of_effects(np.isin(np.arange(len(v)), chosen).astype(float))


def _gain(S: Float[np.ndarray, "k k"], v: Float[np.ndarray, " k"], rows: list[int]) -> float:
    A = S[np.ix_(rows, rows)] + 1e-9 * np.eye(len(rows))
    return 0.5 * float(v[rows] @ np.linalg.solve(A, v[rows]))


METHODS: Mapping[str, Callable[[Problem], Probabilities]] = {"gibbs": gibbs, "alone": alone, "susie": susie, "bic": bic}


def main(folder: Path, name: str) -> None:
    said: dict[str, list[tuple[dict, Probabilities]]] = {method: [] for method in METHODS}
    prior = EffectPrior()
    for path in sorted(folder.glob(f"cases/*/{name}")):
        truth = json.loads((folder / "sealed" / f"{path.parent.name}.json").read_text())
        given = problem(path, prior)
        if given is not None:
            for method, named in METHODS.items():
                said[method].append((truth, named(given)))
    table = pd.DataFrame([{"method": method} | _scored(found) for method, found in said.items()])
    seed = json.loads((folder / "benchmark.json").read_text())["seed"]
    drawn = f"{len(said['gibbs'])} whole cars of seed {seed}"
    text = f"{drawn}, {date.today()}, {platform.platform()}.\n\n{markdown(table)}"
    write_text(RESULTS / "selectors.md", text)
    print(text)


def _scored(found: list[tuple[dict, Probabilities]]) -> dict[str, str]:
    strong, alike, wrong, inclusion = list[float](), list[float](), list[int](), list[tuple[float, float]]()
    for truth, p in found:
        there = standing(truth)
        for effect, one in truth["effects"].items():
            if one["inside"] and one["snr_beyond"] >= STRONG:
                strong.append(p.get(effect, 0.0))
                alike.append(max(p.get(k, 0.0) for k in (effect, *one["alike"])))
        wrong.append(sum(x > NAMED and effect not in there for effect, x in p.items()))
        own = {*truth["effects"], *truth["inherent"]}
        inclusion += [(p[effect], float(effect in own)) for effect in CATALOGUE if p.get(effect, 0.0) > 0.0]
    return {
        f"of SNR {STRONG:g}, above {NAMED}": f"{np.mean(np.array(strong) > NAMED):.2f}",
        "or what is like it": f"{np.mean(np.array(alike) > NAMED):.2f}",
        "wrong names a case": f"{np.mean(wrong):.2f}",
        "calibration error": f"{calibration(np.array(inclusion)):.3f}",
    }


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2])
