"""The model with every effect in: its linear problem, and what is found in recordings whose truth is known."""

from dataclasses import replace

import numpy as np
import pytest
from recorded import TRUTH, fitted, lateral, recorded
from test_effect_prior import stated

from vehicle_sbi.inference.directions import directions, left_out, null
from vehicle_sbi.inference.information import PLAIN, SEEN
from vehicle_sbi.mismatch.estimation.elsewhere import elsewhere
from vehicle_sbi.mismatch.estimation.expansion import WIDER, Expansion
from vehicle_sbi.mismatch.estimation.fit import STEP, Fit, Shrinkage, linearise
from vehicle_sbi.mismatch.estimation.linear_gaussian import (
    LinearGaussian,
    beyond_base,
    linear_gaussian,
    order,
    origin,
    per_coefficient,
    showing,
)
from vehicle_sbi.mismatch.estimation.to_nulls import _nulls, to_nulls
from vehicle_sbi.mismatch.hypotheses.discrepancy import Discrepancy, responses
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.mismatch.selection import expand_and_prune as pruning
from vehicle_sbi.mismatch.selection.expand_and_prune import (
    Budget,
    _likeliest_before,
    expand_and_prune,
    groups_of,
)
from vehicle_sbi.mismatch.selection.extended import with_effects
from vehicle_sbi.mismatch.selection.gibbs import started
from vehicle_sbi.mismatch.selection.inclusion import Chain
from vehicle_sbi.mismatch.selection.pruned import Pruned, folded
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE, EFFECT_PARAMETERS, TYRE_CURVES
from vehicle_sbi.physics.single_track import INPUTS

SHORT = Budget(last=Chain(chains=2, sweeps=160, forgotten=60, every=2))


@pytest.fixture(scope="module")
def base() -> Fit:
    """The base model's fit to a car whose body rolls and whose steering is late."""
    observation = recorded(
        lateral(seconds=20.0, known_start=False), body_roll__gradient=0.008, steering_delay__time=0.05
    )
    return fitted(observation)


@pytest.fixture(scope="module")
def expanded(base: Fit) -> tuple[Expansion, Fit]:
    expansion = Expansion.of(base.simulator.space, left_out(base.simulator, base.theta), stated())
    start = np.concatenate([base.theta, expansion.rest[len(base.theta) :]])
    fit = expansion.fitted(expansion.observed(base), start, np.full(len(expansion.sizes), WIDER))
    assert fit is not None
    return expansion, fit


@pytest.fixture(scope="module")
def discrepant(expanded: tuple[Expansion, Fit]) -> list[Discrepancy]:
    return [one.about(expanded[1]) for one in responses(expanded[1])]


@pytest.fixture(scope="module")
def pruned(base: Fit) -> Pruned:
    known = left_out(base.simulator, base.theta)
    found = expand_and_prune(base, known, None, prior=stated(), rng=np.random.default_rng(0), budget=SHORT)
    assert found is not None
    return found


@pytest.mark.parametrize("grade", [0.001, 0.003])
def test_what_happened_in_the_fitted_recording_is_in_no_derivative_of_another(grade: float) -> None:
    # A gyro does not see the road's grade, whose profile is tied to the clock of the recording it was fitted to.
    base = fitted(recorded(lateral(seconds=10.0)))
    names = ("gyro_bias", "road_grade_profile")
    known = [d for name in names for d in directions(base.simulator, base.theta, CATALOGUE[name])]
    expansion = Expansion.of(base.simulator.space, known, stated())
    theta, bias = expansion.rest.copy(), expansion.space.column("gyro_bias.z")
    theta[: len(base.theta)] = base.theta
    theta[bias] = 0.15 * expansion.unit[bias]
    theta[[k for k, name in enumerate(expansion.space.names) if name.startswith("road_grade_profile")]] = grade
    observation = base.observation.freeing(expansion.space.parameters)
    fit = Fit(observation, theta, linearise(observation.simulator, theta))
    there = elsewhere(fit, recorded(lateral(seconds=10.0), seed=5), apart=True)
    slope, secant = there.white[bias], to_nulls(expansion, [fit, there])[1].white[bias]
    assert slope @ secant > 0.999 * np.linalg.norm(slope) * np.linalg.norm(secant)


def test_draws_beyond_a_bound_keep_their_spread_within_it() -> None:
    drawn = np.random.default_rng(0).normal([1.0, 0.5, -9.0], [0.1, 0.1, 0.1], (4000, 3))
    low, high = np.zeros(3), np.full(3, 0.8)
    found = folded(drawn, low, high)
    assert ((found >= low) & (found <= high)).all()
    inside = (drawn >= low) & (drawn <= high)
    np.testing.assert_array_equal(found[inside], drawn[inside])
    # A mean two deviations beyond a bound is as far within it; cut off, it would have a deviation of 0.006.
    assert found[:, 0].mean() == pytest.approx(0.6, abs=0.01)
    assert found[:, 0].std() == pytest.approx(0.1, abs=0.01)
    np.testing.assert_array_equal(found[:, 2], 0.4)  # farther than the box is wide, but in its lower half


def test_of_an_effect_that_is_not_plain_the_linear_model_is_exact_where_all_others_take_it_over(
    expanded: tuple[Expansion, Fit],
) -> None:
    expansion, fit = expanded
    own, valid, unit = len(expansion.base), fit.simulator.windows.valid, per_coefficient(expansion, fit)
    (steady,), c = to_nulls(expansion, [fit]), expansion.coefficients(fit.theta)
    absorbing, taken = np.linalg.qr((fit.white[:own] * unit[:own, None]).T)[0], 0
    for k in range(own, own + len(expansion.sizes)):
        (back,) = _nulls(expansion, [fit], np.array([k]))
        simulated = fit.simulator.noise_free(back[None])[0]
        white = fit.metric(np.where(valid, simulated - fit.at.y, 0.0)).reshape(-1)
        if abs(c[k]) <= 0.1 or not np.linalg.norm(white - absorbing @ (absorbing.T @ white)) < PLAIN:
            np.testing.assert_array_equal(steady.at.J[k], fit.at.J[k])
            continue
        J = fit.at.J.copy()
        J[k] = steady.at.J[k]
        along = np.tensordot((expansion.coefficients(back) - c) * unit, J, axes=1)
        np.testing.assert_allclose((fit.at.y + along)[valid], simulated[valid], atol=1e-9)
        taken += 1
    assert taken >= 2
    others = [k for k in range(len(fit.theta)) if not own <= k < own + len(expansion.sizes)]
    np.testing.assert_array_equal(steady.at.J[others], fit.at.J[others])


def test_all_others_make_up_for_an_effect_at_its_null_as_well_as_they_can(
    base: Fit, expanded: tuple[Expansion, Fit]
) -> None:
    # Of the points with one size at its null theirs is the least of the quadratic model: it does not fall along others.
    three = expanded[0].only({"gyro_bias.z", "accelerometer_bias.y", "body_roll.gradient"})
    observation = base.observation.freeing(three.space.parameters)
    theta = three.rest.copy()  # in the middle of the boxes, so that no bound is in the way
    theta[len(three.base) : len(three.base) + len(three.sizes)] += 0.2 * three.typical
    shrinkage = Shrinkage(three.rest, three.precision(np.full(len(three.sizes), WIDER)))
    fit = Fit(observation, theta, linearise(observation.simulator, theta), shrinkage)
    unit, c = per_coefficient(three, fit), three.coefficients(theta)
    white, held = fit.white * unit[:, None], shrinkage.precision * unit**2
    for k, p in enumerate(three.sizes, start=len(three.base)):
        (back,) = _nulls(three, [fit], np.array([k]))
        assert back[k] == null(p)
        moved = three.coefficients(back) - c
        slope = white @ (moved @ white) + held * moved
        assert np.abs(np.delete(slope, k)).max() < 1e-6 * abs(slope[k])


def test_a_level_of_stiffnesses_leaves_nothing_on_its_way_back_where_they_are_free(
    base: Fit, expanded: tuple[Expansion, Fit]
) -> None:
    # The level times a stiffness acts, so the recording cannot tell whether it is missing: stiffnesses make up for it.
    simulator, names = base.simulator, ("C_alpha_f", "C_alpha_r", "C_kappa_f", "C_kappa_r")
    stated = np.array([float(simulator.nominal[name]) for name in names])
    stiffnesses = tuple(
        Parameter(name=name, unit="N/rad", low=0.5 * x, high=2.0 * x, fields=(name,))
        for name, x in zip(names, stated.tolist(), strict=True)
    )
    level = replace(expanded[0].only({"stiffness_level.factor"}), base=stiffnesses)
    observation = base.observation.freeing(level.space.parameters)
    theta, same = np.array([*stated, 0.9]), np.array([*(0.9 * stated), 1.0])
    fit = Fit(observation, theta, linearise(observation.simulator, theta))
    alone, together = observation.simulator.noise_free(np.array([[*stated, 1.0], same]))
    np.testing.assert_allclose(together, fit.at.y, rtol=0.0, atol=1e-9)
    (steady,) = to_nulls(level, [fit])
    step = (level.coefficients(same) - level.coefficients(theta)) * per_coefficient(level, fit)
    along = np.tensordot(step[:-1], fit.at.J[:-1], axes=1)
    left, second_order = (
        np.linalg.norm(fit.metric(along + change)) for change in (step[-1] * steady.at.J[-1], alone - fit.at.y)
    )
    # Differences over STEP of a box as wide as 1.5 stiffnesses miss that part of the second order of a change by 0.1,
    # in each of five columns.
    assert left < 5 * (STEP * 1.5 / 0.1) * second_order


def test_a_fit_believes_of_what_is_always_there_what_the_sampler_does(expanded: tuple[Expansion, Fit]) -> None:
    # Else it slides to a bound along what can hardly be told apart, and the sampler's linear model is one about there.
    expansion, _ = expanded
    groups = groups_of(expansion, [], stated())
    every, n = np.ones(len(groups.stop), dtype=np.int64), len(expansion.unit)
    sampled = started(np.eye(n), np.zeros(n), groups.believed, every).precision[: groups.start]
    held = expansion.precision(np.full(len(expansion.sizes), WIDER))[order(expansion)][: groups.start]
    np.testing.assert_array_equal(held, sampled)


def test_shapes_are_of_the_sizes_of_their_own_effects_alone(
    expanded: tuple[Expansion, Fit], discrepant: list[Discrepancy]
) -> None:
    expansion, fit = expanded
    groups = groups_of(expansion, discrepant, stated())
    ends = np.cumsum(expansion.groups) - 1
    assert groups.shaped.shape == (len(expansion.shapes), len(ends) + len(discrepant))
    for p, row in zip(expansion.shapes, groups.shaped, strict=True):
        effects = {expansion.sizes[ends[k]].name.split(".")[0] for k in np.flatnonzero(row)}
        assert effects == {p.name.split(".")[0]}
    held = origin(expansion, fit.theta)
    shapes = slice(len(expansion.base), len(expansion.base) + len(expansion.shapes))
    np.testing.assert_array_equal(held[shapes], expansion.coefficients(fit.theta)[-len(expansion.shapes) :])
    held[shapes] = 0.0
    assert not held.any()


def test_one_of_several_sizes_takes_the_place_of_all(base: Fit) -> None:
    known = directions(base.simulator, base.theta, CATALOGUE["gyro_bias"])
    known += directions(base.simulator, base.theta, CATALOGUE["accelerometer_bias"])
    expansion, k = Expansion.of(base.simulator.space, known, stated()), len(base.theta)
    sizes = np.arange(len(expansion.sizes))
    for sign in (-1.0, 1.0):
        c = np.zeros(len(expansion.space))
        c[k + sizes] = sign * np.linspace(0.1, 0.2, len(sizes))
        found = expansion.coefficients(np.array(expansion.alone(expansion.theta(c), sizes)))
        np.testing.assert_allclose(found[:, k:], sign * WIDER * np.eye(len(sizes)), atol=1e-12)
        np.testing.assert_allclose(found[:, :k], 0.0, atol=1e-12)


def test_a_tyre_is_given_the_curve_that_it_has_from_a_mixture_of_others(monkeypatch: pytest.MonkeyPatch) -> None:
    # Three times the steering takes the tyres to where they slide, and so tells how they bend before.
    mild = lateral(seconds=12.0)
    u = mild.windows.u.copy()
    u[..., INPUTS.index("steering")] *= 3.0
    base = fitted(recorded(replace(mild, windows=replace(mild.windows, u=u)), tyre_curve__fullness=0.9))
    known = directions(base.simulator, base.theta, CATALOGUE["tyre_curve"])
    now = pruning._Round.first(base, Expansion.of(base.simulator.space, known, stated()))
    assert now.bent() is now  # where no tyre bends
    start, names = now.start.copy(), now.expansion.space.names
    start[names.index("tyre_curve.early")] = 0.5
    tried, likelier = list[np.ndarray](), Expansion.likelier

    def watched(self: Expansion, observation: Observation, rms: np.ndarray, starts: list[np.ndarray]) -> Fit | None:
        curves = [self.space.column(name) for name in TYRE_CURVES]
        tried.extend(np.array(starts)[:, curves])
        return likelier(self, observation, rms, starts)

    monkeypatch.setattr(Expansion, "likelier", watched)
    found = dict(zip(names, replace(now, start=start, rms=np.full_like(now.rms, WIDER)).bent().start, strict=True))
    alone = WIDER * stated().size_of(EFFECT_PARAMETERS[TYRE_CURVES[0]])
    np.testing.assert_allclose(tried, [[0.0, 0.0, 0.5], *(alone * np.eye(len(TYRE_CURVES)))], atol=1e-12)
    assert found["tyre_curve.fullness"] > 0.6
    assert found["tyre_curve.early"] < 0.2


def test_where_all_effects_are_at_their_nulls_the_linear_model_is_that_of_the_fit(
    expanded: tuple[Expansion, Fit],
) -> None:
    expansion, fit = expanded
    resting = replace(
        fit, theta=np.concatenate([fit.theta[: len(expansion.base)], expansion.rest[len(expansion.base) :]])
    )
    assert to_nulls(expansion, [resting]) == [resting]


@pytest.mark.parametrize("coherence", [0.0, 0.6, 0.999])
def test_a_size_shows_by_what_base_parameters_leave_of_it(expanded: tuple[Expansion, Fit], coherence: float) -> None:
    # A base column of length s takes c^2 s^2 / (s^2 + 1) of a size's, its prior being worth 1: what is left of it, at
    # the far end of the box, has a signal-to-noise ratio of 2.8 just above which it shows.
    roll, s = expanded[0].only({"body_roll.gradient"}), 50.0
    own, columns = len(roll.base), len(roll.unit)
    share = 1.0 - coherence**2 * s**2 / (s**2 + 1.0)
    for factor, expected in ((0.99, False), (1.01, True)):
        t = factor * SEEN / np.sqrt(share) / roll.reach[0]
        H = np.diag(np.repeat([s**2, 1.0, t**2], [own, columns - own - 1, 1]))
        H[0, -1] = H[-1, 0] = coherence * s * t
        assert showing(roll, LinearGaussian(H, np.zeros(columns), np.zeros(0, dtype=int))).tolist() == [expected]


def test_a_discrepancy_shows_by_what_base_parameters_leave_of_it(expanded: tuple[Expansion, Fit]) -> None:
    # Two groups, of three columns and of one; a base column takes c^2 s^2 / (s^2 + 1) of one column of the first.
    roll, s, t, coherence = expanded[0].only({"body_roll.gradient"}), 50.0, 20.0, 0.8
    columns = len(roll.unit)
    H = np.diag(np.repeat([s**2, 1.0, t**2], [len(roll.base), columns - len(roll.base), 4]))
    H[0, columns] = H[columns, 0] = coherence * s * t
    problem = LinearGaussian(H, np.zeros(len(H)), columns + np.array([3, 4]))
    left = 1.0 - coherence**2 * s**2 / (s**2 + 1.0)
    drawn = np.zeros((3, len(H)))
    drawn[:, columns:] = [[1.0, 0.0, 0.0, 0.0], [0.1, 0.3, -0.4, 2.0], [0.0, 0.0, 0.0, -1.0]]
    ratios = t * np.array([[np.sqrt(left), 0.0], [np.sqrt(0.01 * left + 0.25), 2.0], [0.0, 1.0]])
    np.testing.assert_allclose(beyond_base(roll, problem, drawn), ratios, rtol=1e-12)


def test_coefficients_say_where_parameters_are(expanded: tuple[Expansion, Fit]) -> None:
    expansion, fit = expanded
    rng, space = np.random.default_rng(4), expansion.space
    theta = rng.uniform(space.low, space.high, (20, len(space)))
    np.testing.assert_allclose(expansion.theta(expansion.coefficients(theta)), theta, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(expansion.coefficients(expansion.rest), 0.0, atol=1e-12)
    c, h = expansion.coefficients(fit.theta), 1e-6
    numeric = (expansion.theta(c + h) - expansion.theta(c - h)) / (2.0 * h)
    np.testing.assert_allclose(numeric, expansion.slope(fit.theta), rtol=1e-6)
    # Twice a stiffness is as far from it as half of it.
    level = space.column("stiffness_level.front")
    twice, half = (np.where(np.arange(len(space)) == level, x, expansion.rest) for x in (2.0, 0.5))
    both = expansion.coefficients(np.stack([twice, half]))[:, level]
    assert both[0] == pytest.approx(-both[1])


def test_columns_and_residual_are_those_of_the_fit(expanded: tuple[Expansion, Fit]) -> None:
    # At the fit's own coefficients c the linear model leaves over what the fit does: b - H c = X r.
    expansion, fit = expanded
    problem = linear_gaussian(expansion, [(fit, [])])
    c, slope = expansion.coefficients(fit.theta)[order(expansion)], expansion.slope(fit.theta)
    c = c - origin(expansion, fit.theta)
    J = fit.metric(fit.at.J).reshape(len(fit.theta), -1) * (slope / fit.simulator.space.prior_std)[:, None]
    r = fit.metric(fit.residual).reshape(-1)
    scale = np.sqrt(np.diag(problem.H)) * np.linalg.norm(r) + 1e-9
    assert (problem.b - problem.H @ c) / scale == pytest.approx((J @ r)[order(expansion)] / scale, abs=1e-9)


def test_recordings_that_come_twice_tell_parameters_twice(
    expanded: tuple[Expansion, Fit], discrepant: list[Discrepancy]
) -> None:
    expansion, fit = expanded
    columns = [one.whitened for one in discrepant]
    once, twice = (linear_gaussian(expansion, parts) for parts in ([(fit, columns)], [(fit, columns)] * 2))
    n, more = len(expansion.unit), len(once.b) - len(expansion.unit)
    assert twice.H[:n, :n] == pytest.approx(2.0 * once.H[:n, :n])
    assert twice.H[n : n + more, n + more :] == pytest.approx(np.zeros((more, more)))  # courses of their own


def test_a_discrepancy_s_columns_are_what_its_series_do_in_units_of_the_noise(
    expanded: tuple[Expansion, Fit], discrepant: list[Discrepancy]
) -> None:
    _, fit = expanded
    for one in discrepant:
        white = fit.metric(one.series).reshape(len(one.series), -1)
        assert white == pytest.approx(one.whitened, abs=1e-6 * np.abs(one.whitened).max())


def test_what_is_missing_is_named_and_its_sizes_hold(pruned: Pruned) -> None:
    # A steering delay may be a sensor's or a lag, body roll a gain of the accelerometer or the tyres': which of them is
    # at one frequency of the steering not told, that one of them is there is.
    assert pruned.any_of(["steering_delay", "steering_lag", "sensor_delay", "sensor_lag"]) > 0.5
    assert pruned.any_of(["body_roll", "accelerometer_scale"]) > 0.5
    assert max(pruned.effects.values()) <= 1.0


def test_base_parameters_hold_the_truth_though_physics_is_missing(base: Fit, pruned: Pruned) -> None:
    # 3 parameters within 99.9 % each: 3.3 standard deviations.
    for p, truth in zip(pruned.expansion.base, TRUTH, strict=True):
        draws = pruned.draws(p.name)
        assert abs(draws.mean() - truth) < 3.3 * draws.std(), p.name
        assert draws.std() < 0.9 * (p.high - p.low) / np.sqrt(12.0), p.name


def test_draws_lie_in_their_boxes(pruned: Pruned) -> None:
    space = pruned.fit.simulator.space
    assert np.all((pruned.theta >= space.low) & (pruned.theta <= space.high))


@pytest.mark.slow
def test_what_is_believed_to_be_rare_is_named_less(base: Fit, pruned: Pruned) -> None:
    known = left_out(base.simulator, base.theta)
    table = {effect: {k: list(entry) for k, entry in of.items()} for effect, of in stated().table.items()}
    for entry in table["body_roll"].values():
        entry[0] = 1e-4
    rare = replace(stated(), table=table)
    found = expand_and_prune(base, known, None, prior=rare, rng=np.random.default_rng(0), budget=SHORT)
    assert found is not None
    assert found.effects["body_roll"] <= pruned.effects["body_roll"] + 0.05


def test_a_next_start_is_the_likeliest_on_the_way_that_the_car_can_be_simulated_at(
    expanded: tuple[Expansion, Fit],
) -> None:
    expansion, fit = expanded
    for theta in (fit.theta + 0.02 * (expansion.rest - fit.theta), expansion.rest):
        start = _likeliest_before(fit, theta)
        points = fit.theta + np.array([0.0, 0.01, 0.1, 0.25, 0.5, 1.0])[:, None] * (theta - fit.theta)
        cost = fit.costs(np.concatenate([start[None], points]), fit.simulator.noise_free(np.stack([start, *points])))
        assert cost[0] == cost.min()
    spun = fit.theta.copy()  # the rear axle cannot hold a car whose mass lies there
    for name, value in {"l_f": 2.4, "delta_C_alpha_r": -0.9}.items():
        spun[expansion.space.column(name)] = value
    assert not np.isfinite(fit.simulator.noise_free(spun[None])).all()
    start = _likeliest_before(fit, spun)
    share = (start - fit.theta)[spun != fit.theta] / (spun - fit.theta)[spun != fit.theta]
    assert np.ptp(share) < 1e-9
    assert 0.0 <= share[0] < 1.0
    there, here = (fit.costs(x[None], fit.simulator.noise_free(x[None]))[0] for x in (start, fit.theta))
    assert there <= here
    assert np.isfinite(fit.simulator.noise_free(start[None])).all()


def test_the_likeliest_model_is_fitted_although_no_draw_of_it_can_be_simulated(base: Fit, pruned: Pruned) -> None:
    # Draws are those of a linear model: friction and stiffness may go together in it where the car spins.
    effects = next(one for one in pruned.sets if one)
    spun = pruned.theta.copy()
    for name, value in {"l_f": 2.4, "delta_C_alpha_r": -0.9}.items():
        spun[:, pruned.fit.simulator.space.column(name)] = value
    usual, found = (with_effects(base, one, effects) for one in (pruned, replace(pruned, theta=spun)))
    assert usual is not None
    assert found is not None
    assert found.fit.log_likelihood == pytest.approx(usual.fit.log_likelihood, abs=0.5)


def test_a_friction_that_is_stated_too_high_is_found_although_nothing_changes_near_it() -> None:
    # Tyres of the stated friction hardly bend in this drive, those of 0.4 of it slide; l_f takes it up meanwhile.
    base = fitted(recorded(lateral(seconds=12.0), friction_level__factor=0.4))
    known = [d for d in left_out(base.simulator, base.theta) if d.effect in ("friction_level", "gyro_bias")]
    found = expand_and_prune(base, known, None, prior=stated(), rng=np.random.default_rng(0), budget=SHORT)
    assert found is not None
    assert found.effects["friction_level"] == 1.0
    at, l_f = dict(zip(found.fit.simulator.space.names, found.fit.theta, strict=True)), found.draws("l_f")
    assert at["friction_level.factor"] * at["friction_level.front"] == pytest.approx(0.4, rel=0.1)
    assert abs(l_f.mean() - TRUTH[0]) < 4.0 * l_f.std()


@pytest.mark.parametrize("factor", [1.0, 4.0])
def test_annealing_is_under_so_many_times_the_sensors_noise_with_effects_at_their_nulls(
    base: Fit, factor: float
) -> None:
    now = pruning._Round.first(base, Expansion.of(base.simulator.space, left_out(base.simulator, base.theta), stated()))
    fit, sensor = now.eased(factor), base.simulator.noise.of_sensor
    assert fit is not None
    np.testing.assert_allclose(fit.simulator.noise.floor, factor * sensor.floor)
    assert not fit.simulator.noise.rho.any()
    sizes = slice(len(base.theta), len(base.theta) + len(now.expansion.sizes))
    # What holds a size within 0.02 of its typical one holds it to a tenth of that unless it gains 12 units by itself.
    assert np.median(np.abs(now.expansion.coefficients(fit.theta)[sizes])) < 0.02


@pytest.mark.slow
def test_rounds_of_which_the_last_cannot_be_simulated_where_it_helps_to_name_are_pooled(
    base: Fit, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Asked before the first round and in each of three: in the last there are half as many discrepancies. Annealing
    # does not ask.
    asked, further = list[Fit](), pruning._further

    def fails_last(fit: Fit, naming: Observation | None) -> list[Fit]:
        if naming is None:
            return []
        asked.append(fit)
        return further(fit, naming) if len(asked) < 4 else []

    monkeypatch.setattr(pruning, "_further", fails_last)
    known = left_out(base.simulator, base.theta)
    found = expand_and_prune(base, known, base.observation, prior=stated(), rng=np.random.default_rng(0), budget=SHORT)
    assert found is not None
    assert len(asked) == 4
    assert found.unexplained.shape == (len(found.theta),)
