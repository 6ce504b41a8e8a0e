"""A stage's file is data: it comes back as it was, object for object, or is refused; nothing in it is ever run."""

import ast
import json
import pickle
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from conftest import ROOT
from recorded import TRUTH, lateral, recorded

from vehicle_sbi.files import write_atomically
from vehicle_sbi.inference.directions import Direction, directions
from vehicle_sbi.mismatch.estimation.fit import Fit, linearise
from vehicle_sbi.mismatch.estimation.fit_check import FitCheck
from vehicle_sbi.mismatch.estimation.model import Model
from vehicle_sbi.mismatch.hypotheses.block import Stretch
from vehicle_sbi.mismatch.hypotheses.discrepancy import Remainder
from vehicle_sbi.mismatch.hypotheses.regressor import targets
from vehicle_sbi.mismatch.selection.detection import Examined, Place
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.physics.record import RECORD
from vehicle_sbi.report import stage_file
from vehicle_sbi.report.stage_file import StageFileError, dataclasses_in, read


def write(path: Path, value: Any, kind: Any) -> None:
    write_atomically(path, lambda file: stage_file.write(file, value, kind))


UNSAFE = {"pickle", "cPickle", "cloudpickle", "dill", "joblib", "marshal", "shelve"}
GAIN = Parameter(name="a.gain", unit="1", low=-1.0, high=1.0, fields=("gain",), null=0.0)


@dataclass(frozen=True)
class Trap:
    """Whoever unpickles it writes a file."""

    path: Path

    def __reduce__(self) -> tuple[Callable[..., object], tuple[Path, ...]]:
        return Path.touch, (self.path,)


def a_fit(windows: int = 1) -> Fit:
    """At the truth, of as many windows."""
    observation = recorded(lateral())
    there = observation.simulator.windows
    many = {name: np.concatenate([getattr(there, name)] * windows) for name in ("u", "before", "x0", "t")}
    many |= {name: np.tile(getattr(there, name), windows) for name in ("y", "valid")}
    simulator = replace(observation.simulator, windows=replace(there, **many))
    observation = replace(observation, simulator=simulator, observed=np.tile(observation.observed, windows))
    return Fit(observation, TRUTH, linearise(simulator, TRUTH))


@dataclass(frozen=True)
class Kept:
    """What a stage may hold: models about one fit, what was examined about it, directions, and what is left over."""

    models: list[Model]
    examined: Examined
    again: Examined
    directions: list[Direction]
    remainders: list[Remainder]


@pytest.fixture(scope="module")
def found() -> Kept:
    fit = a_fit()
    known = directions(fit.simulator, fit.theta, CATALOGUE["gyro_bias"])
    named = Model(("gyro_bias",), fit, (), posterior=np.ones((2, 3)))
    place = Place("a_x", 0.0, np.inf, 0.01, 1.0, "", [Stretch("a.csv", 0.0, np.inf)])
    examined = Examined(fit, 0.01, [place])
    k, (target, *_) = np.arange(3.0), targets(fit.simulator, fit.at.y)
    left = [Remainder(target, k, k, 1.0, signal, 0.5, 0.5) for signal in ("speed", "time")]
    return Kept([Model((), fit, ()), named], examined, examined, known, left)


def same(a: object, b: object) -> bool:
    """Whether two trees are of the same types and values throughout."""
    if type(a) is not type(b):
        return False
    if isinstance(a, np.ndarray | np.generic) and isinstance(b, np.ndarray | np.generic):
        return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if is_dataclass(a):
        return all(same(getattr(a, one.name), getattr(b, one.name)) for one in fields(a))
    if isinstance(a, dict) and isinstance(b, dict):
        return same([*a.items()], [*b.items()])
    if isinstance(a, list | tuple) and isinstance(b, list | tuple):
        return len(a) == len(b) and all(map(same, a, b))
    return repr(a) == repr(b)


def test_what_is_read_is_what_was_written(found: Kept, tmp_path: Path) -> None:
    write(tmp_path / "one.npz", found, Kept)
    back = read(tmp_path / "one.npz", Kept)
    assert same(back, found)
    write(tmp_path / "other.npz", back, Kept)
    assert (tmp_path / "other.npz").read_bytes() == (tmp_path / "one.npz").read_bytes()
    np.testing.assert_array_equal(back.examined.fit.residual, found.examined.fit.residual)


def test_one_object_in_several_places_is_one_object_again(found: Kept, tmp_path: Path) -> None:
    write(tmp_path / "one.npz", found, Kept)
    back = read(tmp_path / "one.npz", Kept)
    assert back.examined is back.again
    assert all(model.fit is back.examined.fit for model in back.models)
    one, other = back.remainders
    assert one.target is other.target


def test_values_keep_their_types(tmp_path: Path) -> None:
    record = np.zeros(1, RECORD)[0]
    values = [
        None, True, 2**70, -0.0, np.inf, -np.inf, np.nan, "é", (), [], {}, (1, (2,)), {GAIN: {(1, "a"): [None]}},
        np.float32(0.1), np.float64(np.nan), np.int64(-3), np.bool_(True), record, np.zeros(2, RECORD),
        np.zeros((0, 3)), np.array(1.5), np.asfortranarray(np.eye(3)[:2]), np.array(["a", "bc"]), np.arange(6)[::-2],
    ]  # fmt: skip
    write(tmp_path / "one.npz", values, list[object | Parameter])
    assert same(read(tmp_path / "one.npz", list[object | Parameter]), values)


@pytest.mark.parametrize(
    ("value", "where"),
    [
        (lambda: None, "[0]"),
        ([{"a": (object(),)}], "[0][0][a][0]"),
        (np.array([None]), "[0]"),
        ({GAIN: {1, 2}}, "[0]["),
        (FitCheck(0.5, 0.0), "[0]"),
        (np.ma.masked_array([1.0]), "[0]"),
    ],
)
def test_what_is_no_data_is_refused_with_its_place(value: object, where: str, tmp_path: Path) -> None:
    with pytest.raises(TypeError) as refused:
        write(tmp_path / "one.npz", [value], list[object | Parameter])
    assert str(refused.value).startswith(where)
    assert not (tmp_path / "one.npz").exists()


def test_classes_are_those_of_the_expected_type() -> None:
    assert {"Kept", "Fit", "Parameter", "Target"} <= {one.__name__ for one in dataclasses_in(Kept).values()}
    assert [*dataclasses_in(tuple[FitCheck, ...])] == ["vehicle_sbi.mismatch.estimation.fit_check.FitCheck"]


def refused(path: Path, kind: Any = Kept) -> bool:
    try:
        read(path, kind)
    except StageFileError as error:
        return str(path) in str(error)
    return False


def test_a_pickle_is_refused_and_never_run(tmp_path: Path) -> None:
    # As it is, and as an array of objects in an archive.
    sprung, path = tmp_path / "sprung", tmp_path / "one.npz"
    path.write_bytes(pickle.dumps(Trap(sprung)))
    assert refused(path)
    tree = np.array([Trap(sprung)], dtype=object)
    np.savez(path, tree=tree)
    assert refused(path)
    assert not sprung.exists()
    pickle.loads(pickle.dumps(Trap(sprung)))  # or it would have been no trap
    assert sprung.exists()


def altered(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """The file with its tree changed."""
    with np.load(path) as archive:
        members = {name: archive[name] for name in archive}
    tree = json.loads(members["tree"].tobytes())
    change(tree)
    changed: dict[str, Any] = members | {"tree": np.frombuffer(json.dumps(tree).encode(), np.uint8)}
    np.savez(path, **changed)


@pytest.mark.parametrize(
    "change",
    [
        lambda tree: tree.update(version="0"),
        lambda tree: tree["nodes"][0].__setitem__(0, "builtins.print"),
        lambda tree: tree["nodes"][0].__setitem__(0, "vehicle_sbi.mismatch.estimation.fit.Fit"),
        lambda tree: tree["nodes"][0][1].update(k="large"),
        lambda tree: tree["nodes"][0][1].update(gap=[0]),
        lambda tree: tree["nodes"][0][1].update(k={"O": 1.0}),
        lambda tree: tree["nodes"][0][1].pop("k"),
        lambda tree: tree["nodes"][0][1].update(more=1.0),
        lambda tree: tree.update(root=None),
        lambda tree: tree.update(root=[-2]),
        lambda tree: tree.update(nodes=[]),
        lambda tree: tree.pop("root"),
    ],
)
def test_a_file_of_another_class_version_or_type_is_refused(change: Callable[..., object], tmp_path: Path) -> None:
    path = tmp_path / "one.npz"
    write(path, FitCheck(0.5, 1.0), FitCheck)
    altered(path, lambda tree: None)
    assert read(path, FitCheck) == FitCheck(0.5, 1.0)
    altered(path, change)
    assert refused(path, FitCheck)


def test_a_file_that_is_damaged_is_refused(found: Kept, tmp_path: Path) -> None:
    path = tmp_path / "one.npz"
    write(path, found, Kept)
    whole = path.read_bytes()
    for cut in (0, 1, 100, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:cut])
        assert refused(path)
    rng = np.random.default_rng(0)
    for at in rng.integers(len(whole), size=50):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 255]) + whole[at + 1 :])
        assert refused(path) or same(read(path, Kept), found)  # a byte that says nothing, as a file's date


def test_a_fit_of_four_windows_is_written_at_once(tmp_path: Path) -> None:
    # Its numbers and little more: 0.4 MB, which any disk takes in a part of half a second.
    fit = a_fit(windows=4)
    numbers = [fit.observation.observed, fit.at.y, fit.at.J, fit.at.J_x, *vars(fit.simulator.windows).values()]
    start = time.perf_counter()
    write(tmp_path / "one.npz", (fit, FitCheck(0.5, 0.0)), tuple[Fit, FitCheck])
    assert time.perf_counter() - start < 0.5
    size = sum(one.nbytes for one in numbers if isinstance(one, np.ndarray))
    assert size < (tmp_path / "one.npz").stat().st_size < size + 20_000


def unsafe(path: Path) -> Iterator[str]:
    """Where a file imports what runs code as it reads data, or asks a reader to."""
    for node in ast.walk(ast.parse(path.read_text())):
        line = f"{path.relative_to(ROOT)}, line {getattr(node, 'lineno', 0)}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            module = node.module if isinstance(node, ast.ImportFrom) else None
            if UNSAFE & {str(name).split(".")[0] for name in (module, *(alias.name for alias in node.names))}:
                yield line
        if isinstance(node, ast.Attribute) and node.attr in ("read_pickle", "to_pickle"):
            yield line
        if isinstance(node, ast.Call):
            given = {one.arg: getattr(one.value, "value", None) for one in node.keywords}
            if given.get("allow_pickle", False) is not False:
                yield line
            if ast.unparse(node.func) == "torch.load" and given.get("weights_only") is not True:
                yield line


def test_nothing_reads_data_that_could_run_code() -> None:
    files = [path for folder in ("vehicle_sbi", "scripts", "benchmarks") for path in (ROOT / folder).rglob("*.py")]
    assert len(files) > 50
    assert not [line for path in files for line in unsafe(path)]
    assert [*unsafe(Path(__file__))]  # this one does, on purpose
