"""A diagnosis from a case to its verdict, step by step; each step may be kept by whoever asks for it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from vehicle_sbi.inference.directions import Direction, beside, left_out
from vehicle_sbi.mismatch.answer.schema import Verdict
from vehicle_sbi.mismatch.answer.verdict import Found, verdict
from vehicle_sbi.mismatch.design.identifiability import Card, card
from vehicle_sbi.mismatch.estimation.base_fit import fitted
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.estimation.fit_check import FitCheck, mended
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.problem.case import Case
from vehicle_sbi.mismatch.selection.detection import Examined, examine
from vehicle_sbi.mismatch.selection.expand_and_prune import BUDGET, Budget, expand_and_prune
from vehicle_sbi.mismatch.selection.extended import Extended, extended
from vehicle_sbi.mismatch.selection.predictive import Gain, Prediction, gain, predict
from vehicle_sbi.mismatch.selection.pruned import Pruned

STEPS = {
    "fit": "fitting the base model",
    "directions": "what could be missing",
    "separability": "what could be seen",
    "examined": "whether anything is",
    "pruned": "every effect at once",
    "extended": "the likeliest model",
}
Result = TypeVar("Result")
Keep = Callable[[str, type[Result], Callable[[], Result]], Result]
Infer = Callable[[Model], Model]


@dataclass(frozen=True)
class Begun:
    """The base model's fit, and how far it can be trusted."""

    base: Fit
    fit_check: FitCheck


@dataclass(frozen=True)
class AtOnce:
    """What is found with every effect free at once, if that can be simulated."""

    pruned: Pruned | None


def computed(name: str, kind: type[Result], compute: Callable[[], Result]) -> Result:
    """A step's result that is not kept."""
    return compute()


def diagnose(case: Case, *, rng: np.random.Generator, budget: Budget = BUDGET) -> Verdict:
    """The verdict on a case, no files needed."""
    return verdict(case, steps(case, rng=rng, budget=budget))


def steps(
    case: Case,
    *,
    rng: np.random.Generator,
    budget: Budget = BUDGET,
    keep: Keep = computed,
    infer: Infer | None = None,
) -> Found:
    """What every step finds; `keep` is asked for each of STEPS by name, type and how to compute it, `infer` how the
    likeliest model is inferred anew, if it is to be."""
    starts, draws, pruning = rng.spawn(3)  # a step has its own, so that one that is kept changes no other
    begun = keep("fit", Begun, lambda: begin(case, starts))
    base = begun.base
    known = keep("directions", list[Direction], lambda: left_out(base.simulator, base.theta))
    seen = keep("separability", Card, lambda: card(base.simulator, base.theta, known))
    acting = seen.acting(known)
    examined = keep("examined", Examined, lambda: examine(base, seen.visible(known), draws))
    at_once = keep(
        "pruned",
        AtOnce,
        lambda: AtOnce(
            expand_and_prune(
                base,
                [*acting, *beside(base.simulator, base.theta, acting)],
                case.naming,
                prior=case.effect_prior,
                rng=pruning,
                budget=budget,
            )
        ),
    )
    likeliest = keep("extended", Extended, lambda: _extended(base, at_once.pruned, seen, examined.detected, infer))
    predictions, gained = proved(case, Model.without_effects(base), likeliest.model)
    return Found(begun.fit_check, examined, at_once.pruned, likeliest, predictions, gained, seen)


def begin(case: Case, rng: np.random.Generator) -> Begun:
    """The base model's fit, started from many places."""
    return Begun(*mended(fitted(case.observation, rng), rng))


def _extended(base: Fit, pruned: Pruned | None, seen: Card, detected: bool, infer: Infer | None) -> Extended:
    found = extended(base, pruned, seen.alike, detected=detected)
    return replace(found, model=infer(found.model)) if infer and found.model.effects else found


def proved(case: Case, base: Model, model: Model) -> tuple[dict[str, Prediction], Gain | None]:
    """How base and extended model predict what was held out, if they can be simulated there, and what the latter
    gains."""
    models = {"base": base} | ({"extended": model} if model.effects else {})
    tried = {name: predict(one, case.held_out, apart=case.apart) for name, one in models.items()}
    predictions = {name: prediction for name, prediction in tried.items() if prediction is not None}
    return predictions, gain(**predictions) if len(predictions) == 2 else None
