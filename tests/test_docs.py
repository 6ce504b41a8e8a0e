"""The docs: every command in them composes, those of the tutorials run and print what the page shows, the site builds.

A fenced block without a language, or with `sh` or `bash`, holds commands and nothing else; so does inline code that
begins with one of `PROGRAMS`. Of a tutorial, Python blocks run, YAML blocks name in their first line the file whose
keys they replace, and `text` blocks show what was printed, with `…` for what is left out.
"""

from _entry.command_line import spelled_out
from _entry.construction import check_construction

import ast
import functools
import importlib
import inspect
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import pytest
import yaml
from hydra import compose, initialize_config_dir
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

import vehicle_sbi
from vehicle_sbi.command import CONF, VERBS
from vehicle_sbi.errors import InputError

ROOT = Path(__file__).resolve().parent.parent
PAGES = sorted(page.relative_to(ROOT) for page in (ROOT / "README.md", *(ROOT / "docs").rglob("*.md")))
TUTORIALS = [page for page in PAGES if page.name.startswith("tutorial_")]
PROGRAMS = ("vehicle-sbi", "python", ".venv/bin/python", ".venv/bin/vehicle-sbi", "make", "pip", "eval")
COMMANDS, SHOWN = ("", "sh", "bash"), ("text", "yaml", "diff", "python")
FENCE = re.compile(r"^```([^\n`]*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)
INLINE = re.compile(r"(?<!`)`([^`]+)`(?!`)")
QUOTED = re.compile(r"'[^']*'|\"[^\"]*\"")
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[+-]?\d+)?")
ENTRY = "import sys; from vehicle_sbi.command import main; sys.argv[0] = 'vehicle-sbi'; main()"


@dataclass(frozen=True, kw_only=True)
class Block:
    """A fenced block of a page."""

    language: str
    text: str

    @property
    def commands(self) -> list[str]:
        lines = self.text.replace("\\\n", " ").splitlines()
        return [line.strip() for line in lines if line.strip()] if self.language in COMMANDS else []


def blocks(page: Path) -> list[Block]:
    found = FENCE.findall((ROOT / page).read_text(encoding="utf-8"))
    return [Block(language=language, text=text) for language, text in found]


def prose(page: Path) -> str:
    return FENCE.sub("", (ROOT / page).read_text(encoding="utf-8"))


def commands(page: Path) -> list[str]:
    """The commands of a page, those in the running text included."""
    spans = [" ".join(span.split()) for span in INLINE.findall(prose(page))]
    inline = [span for span in spans if span.split()[0] in PROGRAMS and span not in PROGRAMS]
    return [command for block in blocks(page) for command in block.commands] + inline


@functools.cache
def check(command: str) -> None:
    """Raise if the command names something that is not there, or a configuration that does not compose."""
    words = shlex.split(command)
    while re.fullmatch(r"[A-Z_]+=.*", words[0]):
        words = words[1:]
    match words:
        case ["vehicle-sbi" | ".venv/bin/vehicle-sbi", verb, *rest]:
            if not verb.startswith("--"):
                composes(VERBS[verb].path, VERBS[verb].arguments(rest))
        case ["python" | ".venv/bin/python", "-m", "pytest", *rest]:
            assert [word for word in rest if word.endswith(".py") and not (ROOT / word).is_file()] == []
        case ["python" | ".venv/bin/python", script, *rest] if script.startswith("scripts/"):
            composes(ROOT / script, rest)
        case ["python" | ".venv/bin/python", script, *_]:
            assert (ROOT / script).is_file(), script
        case ["make", target, *settings]:
            check_target(target, dict(word.split("=", 1) for word in settings))
        case ["pip", "install", *wanted]:
            check_extras(wanted)
        case ["eval", inner]:
            check(inner.removeprefix("$(").removesuffix(")"))
        case _:
            raise AssertionError(f"no kind of command that is known here: {command}")


def composes(script: Path, typed: Sequence[str]) -> None:
    """The script's configuration composes with these words, fits what it constructs, and lacks nothing."""
    config = re.search(r'@launch\("(\w+)"\)', script.read_text(encoding="utf-8"))
    assert config is not None, script
    for job in jobs([word for word in typed if not word.startswith("-")]):
        with initialize_config_dir(config_dir=str(CONF), version_base=None):
            cfg = compose(config[1], overrides=spelled_out(job))
        assert OmegaConf.missing_keys(cfg) == set()
        check_construction(OmegaConf.to_container(cfg, resolve=True))


def jobs(typed: Sequence[str]) -> Iterator[list[str]]:
    """The words of a command, once for each value that a sweep has for one of them."""
    parsed = OverridesParser.create().parse_overrides(spelled_out(typed))
    swept = next((k for k, override in enumerate(parsed) if override.is_sweep_override()), None)
    if swept is None:
        yield list(typed)
        return
    key, _, values = spelled_out(typed)[swept].partition("=")
    for value in values.split(","):
        yield from jobs([*typed[:swept], f"{key}={value}", *typed[swept + 1 :]])


def check_target(target: str, settings: dict[str, str]) -> None:
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    recipe = re.search(rf"^{target}:.*\n((?:\t.*\n)*)", makefile, re.MULTILINE)
    assert recipe is not None, target
    script = re.search(r"scripts/(\w+\.py) \$\(ARGS\)", recipe[1])
    if script and "ARGS" in settings:
        composes(ROOT / "scripts" / script[1], shlex.split(settings["ARGS"]))


def check_extras(wanted: Sequence[str]) -> None:
    known = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["optional-dependencies"]
    for extras in re.findall(r"vehicle_sbi\[([^]]+)\]", " ".join(wanted)):
        assert set(extras.split(",")) <= set(known)


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_every_block_says_what_it_is_and_every_command_composes(page: Path) -> None:
    unknown = {block.language for block in blocks(page)} - {*COMMANDS, *SHOWN}
    assert {language for language in unknown if not language.startswith("{")} == set()
    for command in commands(page):
        try:
            check(command)
        except Exception as error:
            raise AssertionError(f"{page}: {command}") from error


@pytest.mark.parametrize("wrong", [
    "vehicle-sbi diagnoze drive.csv",
    "vehicle-sbi diagnose drive.csv vehicel=car.yaml",
    "vehicle-sbi diagnose vehicle=car.yaml",
    "vehicle-sbi run drive.csv rounds.simulations=many",
    "vehicle-sbi run -m estimator=nsf,mafia",
    "python scripts/nothing.py",
    "python benchmarks/nothing.py",
    "make nothing",
    "make run ARGS='estimator=mafia'",
    "pip install 'vehicle_sbi[nothing]'",
    "ls",
])  # fmt: skip
def test_a_wrong_command_is_found(wrong: str) -> None:
    refusals = (AssertionError, KeyError, FileNotFoundError, HydraException, OmegaConfBaseException, InputError)
    with pytest.raises(refusals):
        check(wrong)


def unsafe(command: str) -> list[str]:
    """What zsh reads otherwise than bash: patterns that match no file, and comments of an interactive shell."""
    plain = QUOTED.sub("", command)
    return [word for word in plain.split() if re.search(r"[\[\]()^#~{}<>|;&]|=.*[*?]", word)]


@pytest.mark.parametrize("page", PAGES, ids=str)
def test_every_command_survives_zsh(page: Path) -> None:
    assert {command: found for command in commands(page) if (found := unsafe(command))} == {}


def test_an_unquoted_pattern_or_a_comment_does_not_survive() -> None:
    for command in ("vehicle-sbi run effects=[aero_drag]", "pip install vehicle_sbi[ros]", "make run  # a study"):
        assert unsafe(command)
    for command in ("vehicle-sbi run 'effects=[aero_drag]'", 'eval "$(vehicle-sbi --completion)"'):
        assert not unsafe(command)


PYTHON = [(page, block.text) for page in PAGES for block in blocks(page) if block.language == "python"]


@pytest.mark.parametrize(("page", "text"), PYTHON, ids=lambda value: value.name if isinstance(value, Path) else "")
def test_python_calls_the_package_as_it_is(page: Path, text: str) -> None:
    tree = ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module:
            module = importlib.import_module(node.module)
            assert [name.name for name in node.names if not hasattr(module, name.name)] == []
        if isinstance(node, ast.Call) and (function := called(node)):
            keywords = {keyword.arg: None for keyword in node.keywords if keyword.arg}
            inspect.signature(function).bind(*node.args, **keywords)
    assert attributes(tree) == []


def called(node: ast.AST) -> Callable[..., object] | None:
    """The function of the package that a call is of, None for any other."""
    name = node.func.id if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) else ""
    return getattr(vehicle_sbi, name) if name in vehicle_sbi.__all__ else None


def attributes(tree: ast.Module) -> list[str]:
    """Attributes of what the package's functions return that their classes do not have."""
    results = {
        node.targets[0].id: inspect.signature(function).return_annotation
        for node in ast.walk(tree)
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and (function := called(node.value))
    }
    return [
        f"{node.value.id}.{node.attr}"
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in results
        if not hasattr(results[node.value.id], node.attr)
        and node.attr not in getattr(results[node.value.id], "__dataclass_fields__", {})
    ]


def ran(words: Sequence[str], folder: Path) -> str:
    """What a command of the docs prints when it is run in `folder`."""
    search = os.pathsep.join([str(ROOT), str(ROOT / "scripts")])
    environment = os.environ | {"PYTHONPATH": search, "MPLBACKEND": "Agg", "OMP_NUM_THREADS": "1"}
    done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def edited(text: str, folder: Path) -> None:
    """Replace keys of the file that the first line names; it has to have them."""
    file = folder / text.splitlines()[0].lstrip("# ").strip()
    before, change = yaml.safe_load(file.read_text(encoding="utf-8")), yaml.safe_load(text)
    assert change.keys() <= before.keys()
    file.write_text(yaml.safe_dump(before | change), encoding="utf-8")


def shown(line: str) -> re.Pattern[str]:
    """A line of the page as a pattern: any width of space, any digits, anything in the place of `…`."""
    parts = [NUMBER.sub("\0", " ".join(part.split())) for part in line.strip().split("…")]
    pattern = ".*".join(re.escape(part) for part in parts)
    return re.compile(pattern.replace("\0", NUMBER.pattern).replace(re.escape("\0"), NUMBER.pattern))


def assert_printed(text: str, printed: str) -> None:
    """Every line of the page is in the output, in this order."""
    lines = iter(" ".join(line.split()) for line in printed.splitlines())
    for line in filter(None, map(str.strip, text.splitlines())):
        if line != "…":
            assert any(shown(line).fullmatch(found) for found in lines), f"{line}\nis not in\n{printed}"


def test_output_may_differ_in_digits_alone() -> None:
    assert_printed("l_f = 1.65 ± 0.01 m; …\n…\nend", "start\n  l_f  = 1.7 ± 0.1 m; and more\nmiddle\nend")
    for other in ("h_cog = 1.65 ± 0.01 m; more\nend", "l_f = a ± 0.01 m; more\nend", "end\nl_f = 1 ± 1 m; more"):
        with pytest.raises(AssertionError):
            assert_printed("l_f = 1.65 ± 0.01 m; …\nend", other)


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("page", TUTORIALS, ids=str)
def test_a_tutorial_runs_as_it_is_written(page: Path, tmp_path: Path) -> None:
    printed = ""
    for block in blocks(page):
        match block.language:
            case "python":
                printed = ran([sys.executable, "-c", block.text], tmp_path)
            case "yaml":
                edited(block.text, tmp_path)
            case "text":
                assert_printed(block.text, printed)
            case _:
                for command in block.commands:
                    program, *words = shlex.split(command)
                    assert program == "vehicle-sbi"
                    printed = ran([sys.executable, "-c", ENTRY, *words], tmp_path)


@pytest.mark.parametrize("page", TUTORIALS, ids=str)
def test_a_tutorial_is_short(page: Path) -> None:
    assert len(prose(page).split()) < 700


@pytest.mark.slow
@pytest.mark.skipif(not (find_spec("sphinx") and find_spec("myst_nb")), reason="pip install -e '.[docs]' brings Sphinx")
def test_the_site_builds_without_a_warning(tmp_path: Path) -> None:
    build = [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-d", str(tmp_path / "doctrees")]
    done = subprocess.run([*build, str(ROOT / "docs"), str(tmp_path / "site")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    pages = {page.relative_to(ROOT / "docs").with_suffix(".html") for page in map(ROOT.joinpath, PAGES[1:])}
    assert {page for page in pages if not (tmp_path / "site" / page).is_file()} == set()
