"""The page that says how to add an effect is right: its example, applied as it stands, passes the contract."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"```(\w+)\n(.*?)```", re.DOTALL)


def inserted(text: str, block: str, anchor: str) -> str:
    """The text with a block above the only place where `anchor` stands."""
    assert text.count(anchor) == 1, anchor
    return text.replace(anchor, block + anchor)


def test_the_page_s_example_passes_the_contract(tmp_path: Path) -> None:
    for name in ("vehicle_sbi", "tests", "conf"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    blocks = BLOCK.findall((ROOT / "docs" / "add_an_effect.md").read_text())
    assert [kind for kind, _ in blocks] == ["python", "python", "diff"]
    (_, function), (_, entry), (_, change) = blocks
    source = tmp_path / "vehicle_sbi" / "physics" / "effects.py"
    text = inserted(source.read_text(), f"{function}\n\n", "@njit(cache=True)\ndef body_load")
    text = inserted(text, entry, "        # tyres\n")
    old, new = (line[1:] for line in change.splitlines())
    assert text.count(old) == 1
    source.write_text(text.replace(old, new))
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
