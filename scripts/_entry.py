"""The door of every script: Hydra's configuration in, one-line errors out, and a run folder named after what was asked.

Import it before anything else: numpy and torch read the number of their threads when they are imported. One is set here
unless the user has set another, since the cores belong to numba's simulations and small networks gain nothing.

    from _entry import launch

    @launch("config")
    def main(cfg: DictConfig) -> None: ...

    if __name__ == "__main__":
        main()

A wrong value prints one line `error: …` and exits with status 2; HYDRA_FULL_ERROR=1 shows the traceback instead. In a
sweep every failing job prints its line, the others run on, and the status is 2. Anything else is a bug and keeps its
traceback.
"""

import errno
import functools
import hashlib
import inspect
import json
import os
import pydoc
import re
import sys
import types
import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import hydra
import yaml
from hydra.core.hydra_config import HydraConfig
from hydra.errors import (
    ConfigCompositionException,
    InstantiationException,
    MissingConfigException,
    OverrideParseException,
)
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    InterpolationResolutionError,
    MissingMandatoryValue,
    OmegaConfBaseException,
)

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.report.run_folder import RunFolder

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(variable, "1")

CONF = Path(__file__).resolve().parent.parent / "conf"
FILES: Mapping[str, tuple[str, ...]] = {"recording": (".csv", ".txt", ".parquet", ".vbo"), "vehicle": (".yaml", ".yml")}
LONGEST_NAME = 120  # characters; file systems allow 255 for a folder
NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
REFUSALS = NO_ROOM | {
    errno.EROFS, errno.EACCES, errno.EPERM,
    errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST,
}  # fmt: skip
SCALARS: Mapping[type, tuple[str, tuple[type, ...]]] = {
    bool: ("true or false", (bool,)),
    int: ("a whole number", (int,)),
    float: ("a number", (int, float)),
}
Task = Callable[[DictConfig], object]


def launch(config_name: str) -> Callable[[Task], Callable[[], None]]:
    """Make a script's main function from one that takes its composed configuration, `conf/CONFIG_NAME.yaml`."""

    def decorate(task: Task) -> Callable[[], None]:
        traceback_wanted = os.environ.get("HYDRA_FULL_ERROR") == "1"
        script = os.getpid()  # a job of a parallel sweep runs in another process

        @functools.wraps(task)
        def job(cfg: DictConfig) -> object:
            try:
                check_construction(OmegaConf.to_container(cfg, resolve=True))
                return task(cfg)
            except Exception as error:
                line = None if traceback_wanted else sentence(error)
                if line is None:
                    raise
                return Failure(_in_sweep() + line, script)
            finally:
                with suppress(OSError):  # it holds something
                    Path(HydraConfig.get().runtime.output_dir).rmdir()

        @functools.wraps(task)
        def main() -> None:
            os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, instead of printing in its own way
            try:
                sys.argv[1:] = [word for argument in with_recording(sys.argv[1:]) for word in spelled_out(argument)]
                hydra.main(config_path=str(CONF), config_name=config_name, version_base=None)(job)()
            except KeyboardInterrupt:
                print("interrupted; the same command continues from what is already on disk", file=sys.stderr)
                sys.exit(130)
            except Exception as error:
                line = None if traceback_wanted else sentence(error)
                if line is None:
                    raise
                Failure(line, script)
            if failures:
                sys.exit(2)

        return main

    return decorate


def spelled_out(argument: str) -> list[str]:
    """`recording=PATH` and `vehicle=PATH` as Hydra wants them, the group's `file` option and its path."""
    group, _, value = argument.partition("=")
    if group not in FILES or not ("/" in value or Path(value).suffix.lower() in FILES[group]):
        return [argument]
    return [f"{group}=file", f"{group}.path={json.dumps(value)}"]


def with_recording(arguments: Sequence[str]) -> list[str]:
    """`recordings=[A,…]` chooses `recording=A` too, unless the user does: its settings are how all are read."""
    chosen = any(argument.startswith("recording=") for argument in arguments)
    for argument in arguments:
        first = re.fullmatch(r"recordings=\[?\s*['\"]?([^,'\"\[\]]+).*", argument)
        if first and not chosen:
            return [*arguments, f"recording={first[1].strip()}"]
    return list(arguments)


def configured_recordings() -> dict[str, Path]:
    """Files that `recording=NAME` knows, by name: those of --config-dir before the project's own."""
    sources = [Path(one.path) for one in HydraConfig.get().runtime.config_sources if one.schema == "file"]
    return {file.stem: file for source in reversed(sources) for file in (source / "recording").glob("*.yaml")}


def named_recordings(cfg: DictConfig) -> DictConfig:
    """The configuration with names in `recordings` and `heldout` replaced by what their configuration files have.

    Raises InputError where there is none, for a name that is not there, or one of another vehicle than `recording`'s.
    """
    if not cfg.recordings and OmegaConf.is_missing(cfg.recording, "path"):
        raise InputError("recordings: none is given; recordings=[drive.csv,...], or a name that conf/recording has")
    configured = configured_recordings()
    chosen = HydraConfig.get().runtime.choices

    def resolved(entry: str, where: str) -> object:
        if "/" in entry or Path(entry).suffix.lower() in FILES["recording"]:
            return entry
        if entry not in configured:
            raise unknown("recording", entry, configured, where)
        if entry == chosen["recording"]:
            return OmegaConf.to_container(cfg.recording, resolve=True)
        node = typing.cast(DictConfig, OmegaConf.load(configured[entry]))
        (vehicle,) = [d["override /vehicle"] for d in node.get("defaults", []) if "override /vehicle" in d] or [None]
        if vehicle != chosen["vehicle"]:
            raise InputError(
                f"{where}: {entry} is of vehicle {vehicle}, the others of {chosen['vehicle']}; diagnose one car"
            )
        return OmegaConf.to_container(node.recording, resolve=True)

    for where in ("recordings", "heldout"):
        entries = [cfg[where]] if isinstance(cfg[where], str) else typing.cast(list[str], list(cfg[where] or []))
        cfg[where] = [resolved(str(entry), where) for entry in entries]
    return cfg


def warn(lines: Iterable[str]) -> None:
    """What recordings contradict, said before anything is fitted."""
    for line in lines:
        print(f"warning: {line}", file=sys.stderr)


def run_folder(cfg: DictConfig, *, inputs: Mapping[str, str]) -> RunFolder:
    """The run folder of this job, new or resumed; `inputs` are the SHA-256 of the files that it reads."""
    hydra_cfg = HydraConfig.get()
    return RunFolder.open(
        Path(hydra_cfg.runtime.output_dir),
        config=typing.cast(dict[str, object], OmegaConf.to_container(cfg, resolve=True)),
        overrides=list(hydra_cfg.overrides.task),
        inputs=inputs,
        choices={str(group): str(choice) for group, choice in hydra_cfg.runtime.choices.items()},
    )


def study_name(overrides: Sequence[str]) -> str:
    """The folder of a run: what was asked for, in sorted order, so that the same command finds its own folder again.

    Made of characters that need no quotes in a shell or as a value on Hydra's command line. What is cut, or had to be
    replaced, leaves eight digits of a hash of the whole, so that two studies never share a folder.
    """
    if not overrides:
        return "default"
    asked = sorted(override.lstrip("+") for override in overrides)
    readable = "+".join(override.replace("=", "-", 1) for override in asked)
    name = re.sub(r"[^\w.+-]+", "_", readable, flags=re.ASCII).strip("_.")
    if name == readable and len(name) <= LONGEST_NAME:
        return name
    return f"{name[:LONGEST_NAME]}-{hashlib.sha256(' '.join(asked).encode()).hexdigest()[:8]}"


def _study_name_of(overrides: ListConfig) -> str:
    return study_name(typing.cast(list[str], OmegaConf.to_container(overrides, resolve=False)))


OmegaConf.register_new_resolver("study_name", _study_name_of, replace=True)


def check_construction(node: object, where: str = "") -> None:
    """Hold every `_target_` under `node` against the signature it is to be called with, before anything is computed.

    Raises InputError for a key that the signature does not have and for a scalar of another type than it declares.
    """
    if isinstance(node, list):
        for i, child in enumerate(node):
            check_construction(child, f"{where}[{i}]")
    if not isinstance(node, dict):
        return
    if "_target_" in node:
        _check_call(node, where)
    for key, child in node.items():
        check_construction(child, f"{where}.{key}" if where else str(key))


def _check_call(node: Mapping[str, object], where: str) -> None:
    parameters = _signature(node["_target_"], where).parameters
    open_ended = any(p.kind is p.VAR_KEYWORD for p in parameters.values())
    for key, value in node.items():
        if key in parameters:
            _check_scalar(value, parameters[key].annotation, f"{where}.{key}")
        elif not key.startswith("_") and not open_ended:
            raise unknown("key", key, parameters, f"{where} ({node['_target_']})")


def _check_scalar(value: object, annotation: object, where: str) -> None:
    allowed = typing.get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
    scalars = [SCALARS[kind] for kind in allowed if isinstance(kind, type) and kind in SCALARS]
    optional = types.NoneType in allowed
    if value == "???" or len(scalars) + optional < len(allowed) or (value is None and optional):
        return
    kinds = [kind for _, kinds in scalars for kind in kinds]
    if type(value) not in kinds:
        expected = " or ".join([name for name, _ in scalars] + ["null"] * optional)
        raise InputError(f"{where} = {'null' if value is None else value}: must be {expected}")


def _signature(target: object, where: str) -> inspect.Signature:
    called = pydoc.locate(str(target))
    if not callable(called):
        raise InputError(f"{where}: cannot import its _target_ '{target}'")
    return inspect.signature(called)


failures: list[str] = []


@dataclass(frozen=True)
class Failure:
    """What a job that met a wrong value returns, rather than raising, so that the other jobs of a sweep run on.

    Constructed in the process of the script, it prints its line and counts. A worker's one does so when it is unpickled
    there, which constructs it again: Hydra hands no results back to the script.
    """

    line: str
    script: int

    def __post_init__(self) -> None:
        if os.getpid() == self.script:
            failures.append(self.line)
            print(f"error: {self.line}", file=sys.stderr, flush=True)

    def __reduce__(self) -> tuple[type["Failure"], tuple[str, int]]:
        return Failure, (self.line, self.script)


def _in_sweep() -> str:
    """Which job of a sweep this is, to open its line with."""
    cfg = HydraConfig.get()
    return f"job {' '.join(cfg.overrides.task)}: " if cfg.mode == RunMode.MULTIRUN else ""


@functools.singledispatch
def sentence(error: Exception) -> str | None:
    """The line that tells the user what to change, or None if `error` is not about what the user gave."""
    origin = error.__cause__ or error.__context__  # torch turns a full disk into an error of its own
    return sentence(origin) if isinstance(origin, OSError) and origin.errno in NO_ROOM else None


@sentence.register
def _(error: InputError) -> str:
    return _one_line(error)


@sentence.register
def _(error: InstantiationException) -> str | None:
    cause = error.__cause__
    if isinstance(cause, InstantiationException | InputError | OSError):
        return sentence(cause)
    if cause is not None and not isinstance(cause, TypeError | ValueError | ImportError):
        return None
    message, _, where = str(error).partition("full_key: ")
    return _one_line(f"{where}: {cause or message}" if where else str(cause or message))


@sentence.register
def _(error: MissingConfigException) -> str:
    if not error.options or not error.missing_cfg_file:
        return _one_line(str(error).partition("Config search path:")[0])
    group, _, option = error.missing_cfg_file.rpartition("/")
    return _one_line(unknown("option", option, error.options, group))


@sentence.register
def _(error: OverrideParseException) -> str:
    reason = str(error).partition("\nSee ")[0].rpartition("\n")[2]
    return f"cannot read '{error.override}' as key=value: {reason}"


@sentence.register
def _(error: ConfigCompositionException) -> str:
    cause: BaseException = error
    while cause.__cause__ is not None:
        cause = cause.__cause__
    if isinstance(cause, ConfigKeyError | ConfigAttributeError) and isinstance(cause.parent_node, DictConfig):
        return _unknown_key(cause.parent_node, cause)
    message, _, _ = str(error).partition("Config search path:")
    return _one_line(message if cause is error else f"{message} {str(cause).splitlines()[0]}")


def _unknown_key(node: DictConfig, error: OmegaConfBaseException) -> str:
    level, _, _ = str(error.full_key).rpartition(".")
    known = {str(key) for key in node if key != "hydra" and not str(key).startswith("_")}
    if not level:
        known |= {folder.name for folder in CONF.iterdir() if folder.is_dir() and folder.name != "hydra"}
    target = node.get("_target_") if "_target_" in node else None
    accepted = set(_signature(target, level).parameters) if target else set()
    if error.key in accepted:
        return (
            f"{error.full_key} is not in the configuration, which leaves it at its default: write +{error.full_key}=…"
        )
    return _one_line(unknown("key", str(error.key), known | accepted, level or "configuration"))


@sentence.register(MissingMandatoryValue)
@sentence.register(InterpolationResolutionError)
def _(error: OmegaConfBaseException) -> str:
    return _one_line(f"{error.full_key}: {str(error).partition(chr(10))[0]}")


@sentence.register
def _(error: yaml.MarkedYAMLError) -> str:
    mark = error.problem_mark or error.context_mark
    place = f"{mark.name}, line {mark.line + 1}: " if mark else ""
    return _one_line(f"{place}not valid YAML: {error.problem or error.context}")


@sentence.register
def _(error: OSError) -> str | None:
    if error.errno is None and "requested and" in str(error):  # numpy's way of saying that the disk is full
        error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if error.errno not in REFUSALS:
        return None
    path = str(error.filename or HydraConfig.get().runtime.output_dir)  # a full disk does not say for which file
    unreadable = os.path.exists(path) and not os.access(path, os.R_OK)
    verb = "read" if unreadable or error.errno in (errno.ENOENT, errno.EISDIR) else "write"
    return _one_line(f"cannot {verb} {path}: {os.strerror(error.errno).lower()}")


def _one_line(text: object) -> str:
    return " ".join(str(text).split())
