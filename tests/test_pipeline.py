"""A diagnosis without a run folder: the verdict of a case, the same again for the same generator."""

from dataclasses import replace

import numpy as np
import pytest
from test_case import diagnosis, written

from vehicle_sbi.mismatch.pipeline import STEPS, diagnose, steps
from vehicle_sbi.mismatch.problem.case import Case
from vehicle_sbi.mismatch.selection.expand_and_prune import Budget
from vehicle_sbi.mismatch.selection.inclusion import Chain

SHORT = Budget(rounds=1, pooled=1, last=Chain(chains=2, sweeps=160, forgotten=60, every=2))


@pytest.fixture(scope="module")
def case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """A drive with roll that the model does not have, and another one that is held out."""
    folder = tmp_path_factory.mktemp("files")
    fitted, held = (written(folder / f"{name}.csv", k, body_roll__gradient=0.012) for k, name in enumerate("ab"))
    return diagnosis([fitted], [held]).prepare()


def test_a_case_is_diagnosed_without_any_file(case: Case) -> None:
    verdict = diagnose(case, rng=np.random.default_rng(0), budget=SHORT)
    again = diagnose(case, rng=np.random.default_rng(0), budget=SHORT)
    assert verdict.as_json() == again.as_json()
    assert verdict.detected
    # At one frequency of the steering: a_y over v_x times yaw rate is off, which either sensor's gain does too.
    alike = {"body_roll", "accelerometer_scale", "gyro_scale"}
    either = (one for one in verdict.explanations if {*one.effects} & alike)
    assert sum(one.probability + one.beside_unknown for one in either) > 0.5
    assert len(verdict.headline.split()) <= 25
    assert len(verdict.lines) <= 5


def test_each_step_is_asked_for_once_and_in_order(case: Case) -> None:
    asked = list[str]()

    def keep(name, kind, compute):
        asked.append(name)
        return compute()

    steps(replace(case, naming=None), rng=np.random.default_rng(0), budget=SHORT, keep=keep)
    assert asked == [*STEPS]
