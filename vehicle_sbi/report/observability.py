"""What a recording or a manoeuvre could tell of a set of parameters, before anything is inferred."""

import numpy as np
import pandas as pd
from jaxtyping import Float

from vehicle_sbi.inference.information import bound_std, confusable, fisher
from vehicle_sbi.inference.study import Prepared
from vehicle_sbi.mismatch.design.identifiability import card
from vehicle_sbi.report.card import could_show, hidden
from vehicle_sbi.report.tables.posterior import NOT_IDENTIFIED
from vehicle_sbi.rounding import rounded

MEANT = (
    "The bound is the least standard deviation, of a car as in the column 'at', if the model lacks nothing; "
    "diagnose asks whether it does."
)


def observability(prepared: Prepared) -> tuple[pd.DataFrame, list[str]]:
    """A row of text per parameter, with its Cramér-Rao bound at `prepared.point`, and what is to be said of them
    together and of the windows that are used.

    The condition number is that of the Fisher matrix in units of the prior's standard deviations.
    """
    simulator, at = prepared.problem.simulator, prepared.point
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
    notes = [MEANT, f"Condition number of the information, in units of the prior: {condition(F, space.prior_std):.3g}."]
    pairs = confusable(F, space.prior_std)
    notes += [f"Hardly told apart: {space.names[i]} and {space.names[j]}: correlation {r:.2f}." for i, j, r in pairs]
    return table, [*notes, *prepared.notes]


def left_out(prepared: Prepared) -> tuple[pd.DataFrame, list[str]]:
    """A row of text per effect that is not fitted, and what is to be said of them together."""
    found = card(prepared.problem.simulator.alone, prepared.point)
    return could_show(found), hidden(found)


def condition(F: Float[np.ndarray, "d d"], prior_std: Float[np.ndarray, " d"]) -> float:
    """Largest over smallest eigenvalue of the information in units of the prior; infinite where it is singular."""
    values = np.linalg.eigvalsh(F * np.outer(prior_std, prior_std))
    return float(values[-1] / values[0]) if values[0] > 0 else np.inf
