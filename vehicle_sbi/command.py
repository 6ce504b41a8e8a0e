"""The console command `vehicle-sbi VERB …`: each verb is a script of the project and takes the words that it takes.

Scripts lie in `scripts/` of a checkout, and inside the package where it was installed from a wheel.
"""

import ast
import os
import runpy
import sys
import webbrowser
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from io import TextIOWrapper
from pathlib import Path
from typing import NoReturn

PACKAGE = Path(__file__).resolve().parent
RECORDINGS = PACKAGE / "recordings"


def _folder(name: str) -> Path:
    """A folder of the checkout, which an installed package has inside."""
    return next(path for path in (PACKAGE / name, PACKAGE.parent / name) if path.is_dir())


SCRIPTS, CONF = _folder("scripts"), _folder("conf")
HELP = ("--help", "-h")
SAY_ONLY = (*HELP, "--cfg", "-c", "--info", "-i", "--hydra-help", "--version")  # with which nothing is done
TAKE_SEVERAL = ("diagnose", "run", "observability")  # recordings
TAKE_A_VALUE = ("--cfg", "-c", "--package", "-p", "--info", "-i", "--config-dir", "-cd", "--config-name", "-cn")
ALONE = ("--run", "--multirun", "--resolve", "--shell-completion")  # flags without a value
USAGE = "vehicle-sbi VERB key=value …"
MORE = "vehicle-sbi VERB --help says more; --version the version; --completion a script for bash or zsh"


@dataclass(frozen=True, kw_only=True)
class Verb:
    """A script, the words it is given before the user's, the key that a file without one stands for, and the page that
    is opened in the end."""

    script: str
    given: tuple[str, ...] = ()
    file: str | None = None
    says: str | None = None
    opens: str | None = None

    @property
    def path(self) -> Path:
        return SCRIPTS / f"{self.script}.py"

    @property
    def sentence(self) -> str:
        """What it does, in the first sentence of the script's docstring unless it is said here."""
        return self.says or _docstring(self.path).partition("\n\n")[0].replace("\n", " ").rstrip(".")

    def arguments(self, typed: Sequence[str]) -> list[str]:
        """The script's arguments: a file alone becomes the value of its key. Raises ValueError for a second one."""
        before = ["", *typed]
        files = [word for word, after in zip(typed, before, strict=False) if self._is_file(word, after)]
        if len(files) > 1 and "=" not in typed:  # alone it is a slip, which the script names
            several = "; several drives are 'recordings=[a.csv,b.csv]'" if self.script in TAKE_SEVERAL else ""
            raise ValueError(f"'{files[0]}' and '{files[1]}': one is taken, as in {self.file}=FILE{several}")
        return [*self.given, *(self._spelled(word, after) for word, after in zip(typed, before, strict=False))]

    def _spelled(self, word: str, after: str) -> str:
        return f"{self.file}={word}" if self._is_file(word, after) else word

    def _is_file(self, word: str, after: str) -> bool:
        value = after in TAKE_A_VALUE or after.endswith("=") or (after.startswith("--") and after not in ALONE)
        return self.file is not None and not (value or "=" in word or word.startswith(("-", "+", "~")))


VERBS: Mapping[str, Verb] = {
    "demo": Verb(
        script="diagnose",
        given=("recording=demo", "hydra.run.dir=outputs/demo"),
        says="A real recording that ships with the package, diagnosed in about a minute; opens the page",
        opens="outputs/demo/report.html",
    ),
    "inspect": Verb(script="inspect_recording", file="recording"),
    "diagnose": Verb(script="diagnose", file="recording"),
    "run": Verb(script="run", file="recording"),
    "fleet": Verb(script="fleet", file="folder"),
    "calibrate": Verb(script="calibrate"),
    "observability": Verb(script="observability", file="recording"),
    "export": Verb(script="export", file="run"),
    "report": Verb(script="report", file="runs"),
    "catalogue": Verb(script="catalogue"),
    "recordings": Verb(script="recordings"),
}


def main() -> None:
    """Run the verb that the command line begins with; status 141 where nobody reads on, as `head` does not."""
    print_anywhere()
    try:
        _main(sys.argv[1:])
        sys.stdout.flush()
    except BrokenPipeError:
        leave_unread()


def leave_unread() -> NoReturn:
    """End where nobody reads on, with the status of a process that SIGPIPE has ended."""
    discard_output()
    sys.exit(128 + 13)


def discard_output() -> None:
    """Have nothing more written to standard output, as Python does in the end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def print_anywhere() -> None:
    """Have a terminal or a pipe that has no ± or … show ? instead, as code pages of Windows need."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="replace")


def _main(typed: Sequence[str]) -> None:
    name = typed[0] if typed else "--help"
    if name in ("--help", "-h", "help"):
        print(overview())
    elif name == "--version":
        print(version("vehicle-sbi"))
    elif name == "--completion":
        print(completion())
    elif name in VERBS and VERBS[name].given and {*HELP} & {*typed}:
        print(help_of(name))
    elif name in VERBS:
        try:
            arguments = VERBS[name].arguments(typed[1:])
        except ValueError as error:
            print(f"error: {error}", file=sys.stderr)
            sys.exit(2)
        _run(name, arguments)
    else:
        print(f"error: unknown verb '{name}'; known: {', '.join(VERBS)}", file=sys.stderr)
        sys.exit(2)


def overview() -> str:
    """Every verb with a sentence and an example."""
    rows = [f"  {name:<14} {verb.sentence}\n{'':<17}{example(name)}" for name, verb in VERBS.items()]
    return "\n".join([USAGE, "", *rows, "", MORE])


def help_of(name: str) -> str:
    """The help of a verb that is another one with words that are given."""
    verb = VERBS[name]
    plain = next(other for other, one in VERBS.items() if one.script == verb.script and not one.given)
    given = f"It is `vehicle-sbi {plain} {' '.join(verb.given)}`, and takes further keys of `{plain}`:"
    return "\n".join([f"{verb.sentence}.", "", f"  {example(name)}", "", given, f"vehicle-sbi {plain} --help"])


def example(name: str) -> str:
    """The first example of a verb's script, as it is typed here."""
    verb, plain = VERBS[name], f"vehicle-sbi {name}"
    if verb.given:
        return plain
    lines = [line.strip() for line in _docstring(verb.path).splitlines() if line.strip().startswith("python ")]
    return as_typed(name, lines[0]) if lines else plain


def as_typed(name: str, text: str) -> str:
    """Calls of a verb's script in a text, as they are typed here: a file needs no key."""
    verb, plain = VERBS[name], f"vehicle-sbi {name}"
    text = text.replace(f"python scripts/{verb.script}.py", plain)
    return text.replace(f"{plain} {verb.file}=", f"{plain} ")


def completion() -> str:
    """A script for bash and zsh that completes verbs, then files; `eval "$(vehicle-sbi --completion)"` loads it."""
    return (
        'if [ -n "$ZSH_VERSION" ]; then autoload -U +X bashcompinit && bashcompinit; fi\n'
        "_vehicle_sbi() {\n"
        '  local word="${COMP_WORDS[COMP_CWORD]}"\n'
        '  if [ "$COMP_CWORD" -eq 1 ]; then\n'
        f'    COMPREPLY=($(compgen -W "{" ".join(VERBS)}" -- "$word"))\n'
        "  else\n"
        '    COMPREPLY=($(compgen -f -- "${word#*=}"))\n'
        "  fi\n"
        "}\n"
        "complete -o filenames -F _vehicle_sbi vehicle-sbi"
    )


def _run(name: str, arguments: Sequence[str]) -> None:
    """The script as if Python had been started with it."""
    script = VERBS[name].path
    os.environ["VEHICLE_SBI_COMMAND"] = f"vehicle-sbi {name}"  # which its help shows
    sys.argv = [str(script), *arguments]
    sys.path.insert(0, str(SCRIPTS))
    runpy.run_path(str(script), run_name="__main__")
    page = VERBS[name].opens
    if page and Path(page).is_file() and not {*SAY_ONLY} & {*arguments} and _has_screen():
        webbrowser.open(Path(page).resolve().as_uri())


def _has_screen() -> bool:
    """Whether there is a person before a screen, rather than a terminal far away or a test."""
    shown = sys.platform in ("win32", "darwin") or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return bool(shown) and sys.stdout.isatty()


def _docstring(path: Path) -> str:
    return ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
