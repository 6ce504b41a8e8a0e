"""The contract of hypotheses: what holds of every kind of them, whoever made it; a new kind joins a list below."""

import importlib
import pkgutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from recorded import fitted, lateral, recorded
from test_effect_prior import stated
from test_stage_file import same, write

from vehicle_sbi.inference.directions import Direction, directions, null, responses, shapes
from vehicle_sbi.mismatch import hypotheses
from vehicle_sbi.mismatch.estimation.expansion import Expansion
from vehicle_sbi.mismatch.estimation.linearised import Linearised
from vehicle_sbi.mismatch.hypotheses import block, dictionary, discrepancy, effect, quantisation, regressor
from vehicle_sbi.mismatch.hypotheses.hypothesis import Belief, Hypothesis, Together
from vehicle_sbi.mismatch.selection.inclusion import Chain, Groups, Shared, sample
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.report.stage_file import read

PRIOR = stated()
NAMES = ("gyro_bias", "body_roll", "accelerometer_scale", "steering_delay", "friction_level", "gust", "crosswind")
SMOOTH = ("gyro_bias", "body_roll", "accelerometer_scale", "crosswind")  # a delay has kinks, grip has to be used up
Simulated = Callable[[float], np.ndarray]  # the series by the size of a hypothesis

TESTED: Mapping[str, Callable[[Linearised, Sequence[Direction]], list[Hypothesis]]] = {
    "effect": lambda about, known: effect.tested(about.fit, known),
    "block": lambda about, known: block.tested(about.fit),
    "regressor": lambda about, known: regressor.tested(about, effect.tested(about.fit, known)),
}
TOGETHER: Mapping[str, Callable[[Linearised], tuple[Together, np.ndarray]]] = {  # each with what it is to find
    "block": lambda about: (block.together(about, block.tested(about.fit))[0], block.tested(about.fit)[0].change),
    "quantisation": lambda about: (quantisation.together(about)[0], _rounding(about)),
}
BELIEVED: Mapping[str, Callable[[Expansion], list[Belief]]] = {
    "effect": lambda expansion: effect.believed(expansion, PRIOR),
    "discrepancy": lambda expansion: [discrepancy.believed(columns, PRIOR) for columns in (1, 3)],
    "quantisation": lambda expansion: [quantisation.believed(share, PRIOR) for share in (1e-4, 1.0)],
}


def _rounding(about: Linearised) -> np.ndarray:
    """The error of a gyro that rounds to three standard deviations of its noise."""
    error = np.zeros_like(about.fit.at.y)
    error[2] = quantisation.rounding(quantisation.predicted(about.fit)[2], 3.0 * float(about.fit.metric.std[2].mean()))
    return error


@pytest.fixture(scope="module")
def about() -> Linearised:
    """A fit to a drive with nothing missing."""
    return Linearised.of(fitted(recorded(lateral())))


@pytest.fixture(scope="module")
def known(about: Linearised) -> list[Direction]:
    return [d for name in NAMES for d in directions(about.fit.simulator, about.fit.theta, CATALOGUE[name])]


@pytest.fixture(scope="module")
def expansion(about: Linearised, known: Sequence[Direction]) -> Expansion:
    """Of those, and of a profile over time, whose sizes are missing together."""
    profile = [Direction("road_grade_profile", p, {}) for p in CATALOGUE["road_grade_profile"].parameters]
    return Expansion.of(about.fit.simulator.space, [*known, *profile], PRIOR)


def kinds(function: str) -> set[str]:
    """Files of hypotheses that have a function of their own."""
    files = [name for _, name, _ in pkgutil.iter_modules(hypotheses.__path__) if name != "dictionary"]
    modules = {name: importlib.import_module(f"{hypotheses.__name__}.{name}") for name in files}
    return {name for name, module in modules.items() if hasattr(module, function)}


def test_every_kind_goes_through_this_contract() -> None:
    assert kinds("tested") == {*TESTED}
    assert kinds("together") == {*TOGETHER}
    assert kinds("believed") == {*BELIEVED}


def test_the_dictionary_has_every_kind(about: Linearised, known: Sequence[Direction], expansion: Expansion) -> None:
    alone = dictionary.tested(about, known)
    assert len(alone) == sum(len(made(about, known)) for made in TESTED.values())
    assert len(dictionary.together(about, alone)) == len(about.fit.simulator.windows.channels) + 1
    off = [one.about(about.fit) for one in dictionary.sources(about.fit)]
    assert {type(one) for one in off} == {discrepancy.Discrepancy, quantisation.InSteps}
    columns = len(expansion.sizes) + sum(len(one.series) for one in off)
    assert sum(len(one.low) for one in dictionary.believed(expansion, off, PRIOR)) == columns


def test_names_tell_all_hypotheses_apart(about: Linearised, known: Sequence[Direction]) -> None:
    names = [one.name for one in dictionary.tested(about, known)]
    assert all(names)
    assert len({*names}) == len(names)


@pytest.mark.parametrize("kind", TESTED)
def test_sizes_may_be_nothing_and_something(kind: str, about: Linearised, known: Sequence[Direction]) -> None:
    for one in TESTED[kind](about, known):
        assert one.low <= 0.0 <= one.high
        assert one.low < one.high


@pytest.mark.parametrize("kind", TESTED)
def test_a_change_is_that_of_the_series(kind: str, about: Linearised, known: Sequence[Direction]) -> None:
    found = TESTED[kind](about, known)
    assert found
    for one in found:
        assert one.change.shape == about.fit.at.y.shape
        assert np.isfinite(one.change).all()
        assert one.block is None or one.block.channel in about.fit.simulator.windows.channels


def of_effects(about: Linearised, known: Sequence[Direction]) -> list[tuple[Hypothesis, Simulated]]:
    """Effects that change smoothly, by the size of each of their shapes."""
    fit, smooth = about.fit, [d for d in known if d.effect in SMOOTH]

    def of(d: Direction) -> Simulated:
        return lambda size: responses(fit.simulator, fit.theta, [{**d.held, d.parameter: null(d.parameter) + size}])[0]

    tried = [shape for d in smooth for shape in shapes(fit.simulator, d)]
    return [*zip(effect.tested(fit, smooth)[: len(tried)], map(of, tried), strict=True)]


def of_laws(about: Linearised, known: Sequence[Direction]) -> list[tuple[Hypothesis, Simulated]]:
    """Laws by their sizes."""
    fit = about.fit

    def of(law: regressor.Law) -> Simulated:
        return lambda size: regressor.under(fit.simulator, [law]).noise_free(np.array([[*fit.theta, size]]))[0]

    found = regressor.laws(fit.simulator, fit.theta, fit.at.y)
    return [*zip(regressor.tested(about, []), map(of, found), strict=True)]


@pytest.mark.parametrize("simulated", [of_effects, of_laws])
def test_a_change_is_what_a_little_of_it_does_in_simulation(
    simulated: Callable[..., list[tuple[Hypothesis, Simulated]]], about: Linearised, known: Sequence[Direction]
) -> None:
    # By half the step that it was found by, or less. Of what changes in proportion the slopes over two steps differ by
    # a part NONLINEAR at most; what differs by more is tried by a larger step too.
    metric = about.fit.metric
    for one, series in simulated(about, known):
        size = 0.02 * (one.high if one.high > 0.0 else one.low)
        change = metric((series(size) - series(0.0)) / size)
        assert np.linalg.norm(change - metric(one.change)) <= effect.NONLINEAR * np.linalg.norm(change), one.name


@pytest.mark.parametrize("kind", TOGETHER)
def test_gains_are_those_of_each_series_whatever_its_unit_and_none_without_any(kind: str, about: Linearised) -> None:
    e = about.absorbed(about.drawn(5, np.random.default_rng(0)))
    tested, _ = TOGETHER[kind](about)
    gains = tested.gains(e)
    assert gains.shape == (5,)
    assert np.all(gains >= 0.0)
    # Errors of steps are kept in single precision.
    assert np.concatenate([tested.gains(one[None]) for one in e]) == pytest.approx(gains, rel=1e-4, abs=1e-6)
    assert tested.gains(3.0 * e) == pytest.approx(gains, rel=1e-4, abs=1e-6)
    assert np.all(tested.gains(np.zeros_like(e)) == 0.0)


@pytest.mark.parametrize("kind", TOGETHER)
def test_what_is_there_gains(kind: str, about: Linearised) -> None:
    e = about.absorbed(about.drawn(1, np.random.default_rng(0)))
    tested, what = TOGETHER[kind](about)
    assert tested.gains(e + about.absorbed(what[None]))[0] > tested.gains(e)[0] + 10.0


@pytest.mark.parametrize("kind", BELIEVED)
def test_beliefs_are_probabilities_and_amplitudes_beyond_nothing(kind: str, expansion: Expansion) -> None:
    for one in BELIEVED[kind](expansion):
        assert 0.0 < one.rate < 1.0
        assert one.amplitude.shape == one.share.shape
        assert one.share.min() > 0.0
        assert one.share.sum() == pytest.approx(1.0)
        assert 0.0 < one.nothing < one.amplitude.min()
        assert np.all(one.low <= 0.0)
        assert np.all(one.high >= 0.0)


@pytest.mark.parametrize("kind", BELIEVED)
def test_where_nothing_is_recorded_what_is_believed_comes_back(kind: str, expansion: Expansion) -> None:
    # Each group of a sweep is drawn with a probability of 0.6 at least, and then anew: of 4000 sweeps a quarter is
    # independent. Five standard deviations are allowed.
    believed = BELIEVED[kind](expansion)
    none = np.empty(0)
    always = np.zeros((1, len(believed)), dtype=bool)
    groups = Groups.of(believed, always, low=none, high=none, outside=0.01)
    n = 1 + sum(len(one.low) for one in believed)
    shared, chain = Shared(missing=(1.0,), discrepant=(1.0,)), Chain(chains=2, sweeps=2050, forgotten=50, every=1)
    drawn = sample(np.zeros((n, n)), np.zeros(n), groups, shared, chain, np.random.default_rng(0))
    for k, one in enumerate(believed):
        off = 5.0 * np.sqrt(one.rate * (1.0 - one.rate) / 1000.0)
        assert drawn.included[:, k].mean() == pytest.approx(one.rate, abs=off)
        columns = drawn.coefficient[drawn.included[:, k], groups.stop[k] - len(one.low) : groups.stop[k]]
        assert np.all((one.low <= columns) & (columns <= one.high))


def test_an_effect_is_believed_as_often_as_stated_and_on_the_sides_of_its_null_that_its_box_has(
    expansion: Expansion,
) -> None:
    believed = effect.believed(expansion, PRIOR)
    assert max(len(one.low) for one in believed) > 1
    assert [one.rate for one in believed for _ in one.low] == [PRIOR.rate_of(p) for p in expansion.sizes]
    low, high = (np.concatenate([getattr(one, end) for one in believed]) for end in ("low", "high"))
    signs = ((low >= 0.0) * 1 - (high <= 0.0) * 1).tolist()
    assert signs == [(p.low >= null(p)) - (p.high <= null(p)) for p in expansion.sizes]
    assert 1 in signs


def test_hypotheses_are_data_that_a_file_keeps(
    about: Linearised, known: Sequence[Direction], expansion: Expansion, tmp_path: Path
) -> None:
    off = [one.about(about.fit) for one in dictionary.sources(about.fit)]
    kept = (dictionary.tested(about, known), dictionary.believed(expansion, off, PRIOR))
    write(tmp_path / "one.npz", kept, tuple[list[Hypothesis], list[Belief]])
    assert same(read(tmp_path / "one.npz", tuple[list[Hypothesis], list[Belief]]), kept)
