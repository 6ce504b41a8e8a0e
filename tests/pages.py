"""Pages of a diagnosis and of a run that the tests of pages share."""

from pathlib import Path

import numpy as np
from recorded import fitted, lateral, recorded
from test_effect_prior import stated

from vehicle_sbi.inference.directions import left_out
from vehicle_sbi.mismatch.answer.schema import Verdict
from vehicle_sbi.mismatch.answer.verdict import Found, verdict
from vehicle_sbi.mismatch.design.identifiability import card
from vehicle_sbi.mismatch.estimation.fit_check import FitCheck
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.pipeline import proved
from vehicle_sbi.mismatch.problem.case import Case
from vehicle_sbi.mismatch.selection.detection import examine
from vehicle_sbi.mismatch.selection.expand_and_prune import Budget, expand_and_prune
from vehicle_sbi.mismatch.selection.extended import extended
from vehicle_sbi.mismatch.selection.inclusion import Chain
from vehicle_sbi.report.page import run
from vehicle_sbi.report.page.diagnosis import page_of
from vehicle_sbi.report.page.page import Page, write_page
from vehicle_sbi.report.tables.posterior import posterior_table

HOSTILE = "<script>alert(1)</script>"
EFFECTS = ("body_roll", "accelerometer_scale", "gyro_bias", "imu_lever_arm")
SHORT = Budget(rounds=1, pooled=1, last=Chain(chains=2, sweeps=160, forgotten=60, every=2))


def diagnosed() -> tuple[Case, Found, Verdict]:
    """A car whose body rolls, of a hostile name, with the same drive held out."""
    observation = recorded(lateral(), body_roll__gradient=0.012)
    held_out, base = recorded(lateral(), seed=1, body_roll__gradient=0.012), fitted(observation)
    case = Case(
        HOSTILE, observation, None, held_out, (HOSTILE,), True, (f"a note {HOSTILE}",), (f"a warning {HOSTILE}",), (),
        {}, stated(),
    )  # fmt: skip
    known = [d for d in left_out(base.simulator, base.theta) if d.effect in EFFECTS]
    seen, examined = (
        card(base.simulator, base.theta, known),
        examine(base, known, np.random.default_rng(0)),
    )
    pruned = expand_and_prune(base, known, None, prior=case.effect_prior, rng=np.random.default_rng(0), budget=SHORT)
    likeliest = extended(base, pruned, seen.alike, detected=True)
    predictions, gained = proved(case, Model.without_effects(base), likeliest.model)
    found = Found(FitCheck(0.1, 0.0), examined, pruned, likeliest, predictions, gained, seen)
    return case, found, verdict(case, found)


def diagnosis_page(path: Path) -> Page:
    """Write the page of a diagnosis."""
    page = page_of(*diagnosed())
    write_page(path, page)
    return page


def run_page(path: Path, *, seconds: float = 10.0) -> Page:
    """Write the page of a run over a drive of so many seconds, told of l_f and not of the rest."""
    observation = recorded(lateral(seconds=seconds))
    simulator, y = observation.simulator, observation.observed
    space, rng = simulator.space, np.random.default_rng(0)
    samples = rng.uniform(space.low, space.high, (2000, len(space)))
    samples[:, 0] = rng.normal(0.5 * (space.low + space.high)[0], 0.02 * space.prior_std[0], len(samples))
    bound = np.where(np.arange(len(space)) == 0, 0.02, np.inf) * space.prior_std
    page = run.page_of(
        HOSTILE, space, samples, posterior_table(space, samples, bound_std=bound),
        (simulator.windows, y, np.stack([y - 0.1, y, y + 0.1])),
        path=path, figures={}, notes=[f"a note {HOSTILE}"], warnings=[],
    )  # fmt: skip
    write_page(path, page)
    return page
