"""Whatever happens to a file of a run, the same command ends in the same table, or in one line."""

import shutil
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from script_runs import ENVIRONMENT
from test_run_script import QUICK, run

from vehicle_sbi.errors import InputError
from vehicle_sbi.report import manifest as manifests

Harm = Callable[[Path, Path], object]


def flipped(file: Path, other: Path) -> None:
    content = bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)


HARMS: Mapping[str, Harm] = {
    "deleted": lambda file, other: file.unlink(),
    "truncated": lambda file, other: file.write_bytes(file.read_bytes()[: file.stat().st_size // 2]),
    "flipped": flipped,
    "of another run": lambda file, other: shutil.copy(other, file),
}
BOOKKEEPING = {".lock", ".holder", "log.txt"}


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """Two finished runs that differ in their seed."""
    folders = tuple(tmp_path_factory.mktemp("runs") / name for name in ("one", "other"))
    for seed, folder in enumerate(folders):
        status, _, err = run(*QUICK, f"seed={seed}", f"hydra.run.dir={folder}")
        assert status == 0, err
    return folders[0], folders[1]


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("harm", HARMS)
def test_every_file_of_a_finished_run(runs: tuple[Path, Path], tmp_path: Path, harm: str) -> None:
    whole, other = runs
    names = [path.relative_to(whole) for path in sorted(whole.rglob("*")) if path.is_file()]
    for name in (name for name in names if name.name not in BOOKKEEPING):
        folder = tmp_path / name.name
        shutil.copytree(whole, folder)
        HARMS[harm](folder / name, other / name)
        status, _, err = run(*QUICK, "seed=0", f"hydra.run.dir={folder}")
        if status:
            assert (status, err.count("\n")) == (2, 1), f"{name}: {err}"
        else:
            assert (folder / "table.csv").read_bytes() == (whole / "table.csv").read_bytes(), str(name)
            assert (folder / name).exists(), str(name)


@pytest.mark.slow
def test_a_bit_at_any_of_a_hundred_places_of_a_file_is_noticed(runs: tuple[Path, Path], tmp_path: Path) -> None:
    folder = shutil.copytree(runs[0], tmp_path / "run")
    files = manifests.read(folder)["files"]
    assert {"table.csv", "samples.parquet", "posterior.pt", "posterior.nc"} <= files.keys()
    for name in [*files, manifests.FILE]:
        whole = (folder / name).read_bytes()
        for place in np.unique(np.linspace(0, len(whole) - 1, 100).astype(int)):
            changed = bytearray(whole)
            changed[place] ^= 1 << int(place % 8)
            (folder / name).write_bytes(changed)
            if name == manifests.FILE:
                with pytest.raises(InputError):
                    manifests.read(folder)
            else:
                assert not manifests.intact(folder / name, files[name]), f"{name}, byte {place}"
        (folder / name).write_bytes(whole)


@pytest.mark.slow
def test_rounds_of_another_study_are_not_taken(runs: tuple[Path, Path], tmp_path: Path) -> None:
    shutil.copytree(runs[1] / "rounds", tmp_path / "rounds")
    status, _, err = run(*QUICK, "seed=0", f"hydra.run.dir={tmp_path}")
    assert (status, err.count("\n")) == (2, 1)
    assert "whose they are is not known" in err


@pytest.mark.slow
def test_threads_of_the_environment_change_no_digit(runs: tuple[Path, Path], tmp_path: Path) -> None:
    two = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "2")
    status, _, err = run(*QUICK, "seed=0", f"hydra.run.dir={tmp_path / 'run'}", env=ENVIRONMENT | two)
    assert status == 0, err
    for name in ("table.csv", "samples.parquet"):
        assert (tmp_path / "run" / name).read_bytes() == (runs[0] / name).read_bytes()
