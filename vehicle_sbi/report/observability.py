"""What a recording or a manoeuvre could tell of a set of parameters, before anything is inferred."""

import numpy as np
import pandas as pd
from jaxtyping import Float

from vehicle_sbi.inference.information import best_fit, bound_std, confusable, fisher
from vehicle_sbi.inference.study import Prepared
from vehicle_sbi.mismatch.design.identifiability import card
from vehicle_sbi.report.card import could_show, hidden
from vehicle_sbi.report.tables import NOT_IDENTIFIED
from vehicle_sbi.rounding import rounded


def point(prepared: Prepared) -> Float[np.ndarray, " d"]:
    """Where the information is taken: the truth of a synthetic study, or the best fit to a recording."""
    if prepared.truth is not None:
        return prepared.truth
    space, problem = prepared.problem.simulator.space, prepared.problem
    return best_fit(problem.simulator, problem.observed, (space.low + space.high)[None] / 2)[0]


def observability(prepared: Prepared) -> tuple[pd.DataFrame, list[str]]:
    """A row of text per parameter, with its Cramér-Rao bound at `point`, and what is to be said of them together.

    The condition number is that of the Fisher matrix in units of the prior's standard deviations.
    """
    simulator, at = prepared.problem.simulator, point(prepared)
    space, F = simulator.space, fisher(simulator, at)
    bound = bound_std(F, space.prior_std)
    table = pd.DataFrame(
        {
            "parameter": space.names,
            "unit": [p.unit for p in space.parameters],
            "at": [rounded(*pair) for pair in zip(at, np.minimum(bound, space.prior_std), strict=True)],
            "prior std": [rounded(std, std) for std in space.prior_std],
            "bound": [rounded(std, std) for std in bound],
            "identified": np.where(bound < space.prior_std, "yes", NOT_IDENTIFIED),
        }
    )
    notes = [f"Condition number of the information, in units of the prior: {condition(F, space.prior_std):.3g}."]
    pairs = confusable(F, space.prior_std)
    notes += [f"Hardly told apart: {space.names[i]} and {space.names[j]}: correlation {r:.2f}." for i, j, r in pairs]
    return table, notes


def left_out(prepared: Prepared) -> tuple[pd.DataFrame, list[str]]:
    """A row of text per effect that is not fitted, and what is to be said of them together."""
    found = card(prepared.problem.simulator.alone, point(prepared))
    return could_show(found), hidden(found)


def condition(F: Float[np.ndarray, "d d"], prior_std: Float[np.ndarray, " d"]) -> float:
    """Largest over smallest eigenvalue of the information in units of the prior; infinite where it is singular."""
    values = np.linalg.eigvalsh(F * np.outer(prior_std, prior_std))
    return float(values[-1] / values[0]) if values[0] > 0 else np.inf
