"""One contract for every optional effect and both models, stated over the catalogue without naming any."""

from collections.abc import Mapping
from itertools import product

import numpy as np
import pytest
from cars import MILD, PAPER, RATE, V, exciting, finished, integrated, paper_manoeuvre, record_of, simulate
from hypothesis import given, settings
from hypothesis import strategies as st

from vehicle_sbi.parameters import Parameter, ParameterSpace
from vehicle_sbi.physics.body_forces import body_load
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS, Effect
from vehicle_sbi.physics.record import RECORD, derive, nominal_record
from vehicle_sbi.physics.sensors import MOTION
from vehicle_sbi.physics.simulation import FINISHED, MODELS, NOT_FINITE, SPUN_OUT, substeps_for
from vehicle_sbi.physics.single_track import DRIVES
from vehicle_sbi.physics.vehicle import BODY_PRIORS, GENERIC_PRIORS

G, SECONDS = 9.81, 4.0  # [m/s^2]; of the exciting manoeuvre
A_X, A_Y, YAW, OMEGA_F, OMEGA_R, V_X, V_Y = range(7)  # of the rows of MEASUREMENTS

every_effect = pytest.mark.parametrize("effect", CATALOGUE.values(), ids=CATALOGUE)
every_parameter = pytest.mark.parametrize("parameter", EFFECT_PARAMETERS.values(), ids=EFFECT_PARAMETERS)
every_drive = pytest.mark.parametrize("drive", DRIVES)
every_model = pytest.mark.parametrize("model", MODELS)


def records_at(values: Mapping[Parameter, float]) -> np.ndarray:
    """The paper's car with effect parameters at the given values, as a study sets them: through a ParameterSpace."""
    space = ParameterSpace(tuple(values))
    return space.records(np.array([list(values.values())]), nominal_record(PAPER, duration=SECONDS))


def driven(values: Mapping[Parameter, float], model: str, drive: str = "torque") -> np.ndarray:
    """All measurements of the strong manoeuvre."""
    return finished(records_at(values), drive, exciting(SECONDS), (V, 0.0, 0.0), model=model)


def null_of(parameter: Parameter) -> float:
    assert parameter.null is not None
    return parameter.null


def awake(effect: Effect) -> dict[Parameter, float]:
    """Every parameter of an effect well away from its null: halfway to the bound that is farther off."""
    far = {p: p.high if p.high - null_of(p) >= null_of(p) - p.low else p.low for p in effect.parameters}
    return {p: 0.5 * (null_of(p) + bound) for p, bound in far.items()}


# --- the contract ---------------------------------------------------------------------------------------------------


@every_effect
def test_effect_says_what_it_is(effect: Effect) -> None:
    assert all((effect.name, effect.meaning, effect.equation, effect.source, effect.parameters))
    assert effect.enters_at in ("command", "force", "tyre", "sensor")
    assert CATALOGUE[effect.name] is effect


@every_parameter
def test_parameter_has_unit_prior_null_and_fields(parameter: Parameter) -> None:
    assert parameter.unit
    assert parameter.low < parameter.high
    assert parameter.low <= null_of(parameter) <= parameter.high
    assert parameter.name.split(".")[0] in CATALOGUE
    assert set(parameter.fields) <= set(RECORD.names or ())


@every_drive
@every_model
def test_without_effects_inputs_and_motion_pass_untouched(model: str, drive: str) -> None:
    # The integrator alone, fed with the command itself, and its motion read as the measurement: bit for bit what the
    # whole chain gives with every effect at its null. A leaning body turns its IMU, which is left out.
    u = exciting(SECONDS)
    motion = integrated(record_of(PAPER), drive, u, (V, 0.0, 0.0), model=model)
    y = finished(record_of(PAPER), drive, u, (V, 0.0, 0.0), model=model)
    rows = [("v_x", V_X), ("v_y", V_Y)]
    rows += [("a_x", A_X), ("a_y", A_Y), ("r", YAW)] if model == "single_track" else []
    rows += [] if drive == "speed" else [("omega_f", OMEGA_F), ("omega_r", OMEGA_R)]
    for name, row in rows:
        assert np.array_equal(y[row], motion[:, MOTION.index(name)])


def test_without_effects_the_equations_of_motion_are_the_paper_s() -> None:
    p, L, l_f = record_of(PAPER)[0], 2.7, 1.3
    derive(p)
    weight = 1500.0 * G
    assert p["mass"] == 1500.0
    assert p["I_z"] == 1500.0 * l_f * (L - l_f)
    assert p["grip"] == 0.9
    assert p["F_zf_static"] == weight * (L - l_f) / L
    assert p["F_zr_static"] == weight * l_f / L
    assert all(body_load(p, v_x, t, 1.0) == (0.0, 0.0, 0.0) for v_x in (-20.0, 0.0, 0.5, 60.0) for t in (0.0, 3.0))


@every_effect
@every_drive
@every_model
def test_null_is_exact(effect: Effect, drive: str, model: str) -> None:
    assert np.array_equal(driven({p: null_of(p) for p in effect.parameters}, model, drive), driven_plain(model, drive))


def driven_plain(model: str, drive: str = "torque") -> np.ndarray:
    """The same without any effect."""
    return finished(record_of(PAPER), drive, exciting(SECONDS), (V, 0.0, 0.0), model=model)


@every_effect
@every_model
def test_effect_that_is_awake_changes_a_channel(effect: Effect, model: str) -> None:
    assert np.abs(driven(awake(effect), model) - driven_plain(model)).max() > 1e-3


@every_parameter
def test_every_parameter_of_an_awake_effect_matters(parameter: Parameter) -> None:
    # In one of the models: how high an IMU sits, say, matters to a body that rolls or pitches alone.
    values = awake(CATALOGUE[parameter.name.split(".")[0]])
    rested = values | {parameter: null_of(parameter)}
    assert max(np.abs(driven(values, model) - driven(rested, model)).max() for model in MODELS) > 1e-3


@every_effect
@every_model
def test_effect_fades_continuously_into_its_null(effect: Effect, model: str) -> None:
    # A little of the way from the null gives about as little of the change. Delays and lags are the worst: signals that
    # jump are linear between samples, so that of 2 s, a group's and a channel's, this little is 3 % of a sample's 5 ms.
    base, values = driven_plain(model), awake(effect)
    little = {p: null_of(p) + 7e-5 * (value - null_of(p)) for p, value in values.items()}
    change, small = (np.abs(driven(v, model) - base).max() for v in (values, little))
    assert small <= 0.031 * change


def corners_of(effect: Effect) -> np.ndarray:
    """Every corner of an effect's box, or both ends with 30 corners drawn where there are more."""
    bounds = np.array([(p.low, p.high) for p in effect.parameters])
    if len(bounds) <= 5:
        return np.array(list(product(*bounds)))
    drawn = np.random.default_rng(23).integers(0, 2, (30, len(bounds)))
    return np.concatenate([bounds.T, bounds[np.arange(len(bounds)), drawn]])


@every_effect
@every_drive
@every_model
def test_corners_of_an_effect_s_prior_give_numbers(effect: Effect, drive: str, model: str) -> None:
    # An effect may make the car spin, which is counted as such: a storm of 3 kN behind the centre of gravity does, at
    # two of its sixteen corners, and nothing else.
    nominal = nominal_record(PAPER, duration=SECONDS)
    records = ParameterSpace(effect.parameters).records(corners_of(effect), nominal)
    u = exciting(SECONDS)
    u[:, :3] = paper_manoeuvre(MILD, seconds=SECONDS)[:, :3]
    y, outcomes = simulate(records, drive, u, (V, 0.0, 0.0), model=model)
    assert np.isin(outcomes, (FINISHED, SPUN_OUT)).all()
    assert np.isfinite(y[outcomes == FINISHED]).all()
    assert np.isnan(y[outcomes == SPUN_OUT]).all()
    assert np.mean(outcomes == FINISHED) >= 14 / 16


effects = tuple(EFFECT_PARAMETERS.values())
BOXES = {
    "single_track": (*effects, *GENERIC_PRIORS.values()),
    "full_vehicle": (*effects, *GENERIC_PRIORS.values(), *BODY_PRIORS.values()),
}


@every_model
@settings(max_examples=100)
@given(data=st.data(), drive=st.sampled_from(sorted(DRIVES)))
def test_anywhere_in_the_joint_prior_it_finishes_with_numbers_or_spins_out(
    model: str, data: st.DataObject, drive: str
) -> None:
    # All effects and all constants of the vehicle at once: a spin is physics, a NaN would be a bug.
    space, u = ParameterSpace(BOXES[model]), exciting(SECONDS)
    share = data.draw(st.lists(st.floats(0.0, 1.0), min_size=len(space), max_size=len(space)))
    theta = space.low + np.array(share) * (space.high - space.low)
    records = space.records(theta[np.newaxis], nominal_record(PAPER, duration=SECONDS))
    substeps = substeps_for(records, drive, 1.0, RATE, model=model)
    y, outcomes = simulate(records, drive, u, (V, 0.0, 0.0), substeps=substeps, model=model)
    assert outcomes[0] != NOT_FINITE
    assert np.isfinite(y).all() if outcomes[0] == FINISHED else np.isnan(y).all()
