"""The page that says how to add an effect is right: its example, applied as it stands, passes the contract."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)


def applied(text: str, change: str) -> str:
    """The text after a change written as lines that go (-), come (+) or stay."""
    old = "".join(line[1:] for line in change.splitlines(keepends=True) if line[0] != "+")
    new = "".join(line[1:] for line in change.splitlines(keepends=True) if line[0] != "-")
    assert text.count(old) == 1, old
    return text.replace(old, new)


@pytest.mark.slow  # everything is compiled anew
def test_the_page_s_example_passes_the_contract(tmp_path: Path) -> None:
    for name in ("vehicle_sbi", "tests", "conf"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    blocks = BLOCK.findall((ROOT / "docs" / "add_an_effect.md").read_text())
    assert [kind for kind, _ in blocks] == ["python", "diff", "diff"]
    function, entry, call = (block for _, block in blocks)
    catalogue, stage = (tmp_path / "vehicle_sbi" / "physics" / f"{name}.py" for name in ("effects", "body_forces"))
    before = "@compiled\ndef body_load"
    catalogue.write_text(applied(catalogue.read_text(), entry))
    stage.write_text(applied(stage.read_text().replace(before, f"{function}\n\n{before}"), call))
    name = re.search(r"-k (\w+)", (ROOT / "docs" / "add_an_effect.md").read_text())
    assert name is not None
    run = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "tests/test_effects.py", "-k", name[1]],
        cwd=tmp_path,
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout + run.stderr
    passed = re.search(r"(\d+) passed", run.stdout)
    assert passed is not None
    assert int(passed[1]) >= 5
