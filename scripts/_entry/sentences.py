"""One sentence for each kind of error that a user's mistake can raise: what was given, and what to change."""

from _entry.configuration import groups
from _entry.construction import signature
from _entry.output import refusal
from _entry.targets import allowed

import errno
import functools
import os

import yaml
from hydra.core.hydra_config import HydraConfig
from hydra.errors import (
    ConfigCompositionException,
    InstantiationException,
    MissingConfigException,
    OverrideParseException,
)
from omegaconf import DictConfig
from omegaconf.errors import (
    ConfigAttributeError,
    ConfigKeyError,
    InterpolationResolutionError,
    MissingMandatoryValue,
    OmegaConfBaseException,
)

from vehicle_sbi.errors import InputError, unknown

NO_ROOM = {errno.ENOSPC, errno.EDQUOT, errno.EFBIG}
REFUSALS = NO_ROOM | {
    errno.EROFS, errno.EACCES, errno.EPERM,
    errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST,
}  # fmt: skip


@functools.singledispatch
def sentence(error: Exception) -> str | None:
    """The line that tells the user what to change, or None if `error` is not about what the user gave."""
    origin = error.__cause__ or error.__context__  # torch turns a full disk into an error of its own
    return sentence(origin) if isinstance(origin, OSError) and origin.errno in NO_ROOM else None


@sentence.register
def _no_cluster(error: RuntimeError) -> str | None:
    """What submitit says where there is no SLURM; any other as if it were of no kind."""
    if '"srun"' in str(error):
        return "hydra/launcher=submitit_slurm needs a SLURM cluster: there is no srun here"
    return sentence.dispatch(Exception)(error)


@sentence.register
def _wrong_value(error: InputError) -> str:
    return _one_line(error)


@sentence.register
def _failed_construction(error: InstantiationException) -> str | None:
    cause = error.__cause__
    if isinstance(cause, InstantiationException | InputError | OSError):
        return sentence(cause)
    if cause is not None and not isinstance(cause, TypeError | ValueError | ImportError):
        return None
    message, _, where = str(error).partition("full_key: ")
    return _one_line(f"{where}: {cause or message}" if where else str(cause or message))


@sentence.register
def _unknown_option(error: MissingConfigException) -> str:
    if not error.options or not error.missing_cfg_file:
        return _one_line(_without_search_path(error))
    group, _, option = error.missing_cfg_file.rpartition("/")
    return _one_line(unknown("option", option, error.options, group))


@sentence.register
def _unreadable_override(error: OverrideParseException) -> str:
    reason = str(error).partition("\nSee ")[0].rpartition("\n")[2]
    if reason.strip() == "^":  # which stands under the first character that Hydra's grammar does not know
        character = error.override[reason.index("^") - len("LexerNoViableAltException: ")]
        reason = f"{character!r} stands outside quotes; write \"key='value'\""
    return f"cannot read {_printable(error.override)} as key=value: {reason}"


@sentence.register
def _failed_composition(error: ConfigCompositionException) -> str:
    cause = _first_cause(error)
    if isinstance(cause, ConfigKeyError | ConfigAttributeError) and isinstance(cause.parent_node, DictConfig):
        return _unknown_key(cause.parent_node, cause)
    message = _without_search_path(error)
    return _one_line(message if cause is error else f"{message} {str(cause).splitlines()[0]}")


@sentence.register(MissingMandatoryValue)
@sentence.register(InterpolationResolutionError)
def _unresolved_value(error: OmegaConfBaseException) -> str:
    if isinstance(error, MissingMandatoryValue) and str(error.full_key).endswith("recording.path"):
        return "no recording is given: recording=drive.csv names one"
    return _one_line(f"{error.full_key}: {str(error).partition(chr(10))[0]}")


@sentence.register
def _invalid_yaml(error: yaml.MarkedYAMLError) -> str:
    mark = error.problem_mark or error.context_mark
    place = f"{mark.name}, line {mark.line + 1}: " if mark else ""
    return _one_line(f"{place}not valid YAML: {error.problem or error.context}")


@sentence.register
def _refused_file(error: OSError) -> str | None:
    if error.errno is None and "requested and" in str(error):  # numpy's way of saying that the disk is full
        error = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    if error.errno not in REFUSALS:
        return None
    if error.filename is None and refusal() is not None:
        return f"cannot write standard output: {os.strerror(error.errno).lower()}"
    path = str(error.filename or HydraConfig.get().runtime.output_dir)  # a full disk does not say for which file
    unreadable = os.path.exists(path) and not os.access(path, os.R_OK)
    verb = "read" if unreadable or error.errno in (errno.ENOENT, errno.EISDIR) else "write"
    return _one_line(f"cannot {verb} {path}: {os.strerror(error.errno).lower()}")


def _unknown_key(node: DictConfig, error: OmegaConfBaseException) -> str:
    """Of a key that `node` lacks: the known ones, or how to add one that its `_target_` takes."""
    level, _, _ = str(error.full_key).rpartition(".")
    if error.full_key == "recordings":
        return "recordings: one is taken here, recording=drive.csv; `diagnose` fits several together"
    target = node.get("_target_") if "_target_" in node else None
    accepted = set(signature(target, level).parameters) if target in allowed() else set()
    if error.key in accepted:
        return (
            f"{error.full_key} is not in the configuration, which leaves it at its default: write +{error.full_key}=…"
        )
    present = {str(key) for key in node if key != "hydra" and not str(key).startswith("_")}
    known = present | accepted | (set() if level else groups())
    return _one_line(unknown("key", str(error.key), known, level or "configuration"))


def _first_cause(error: BaseException) -> BaseException:
    while error.__cause__ is not None:
        error = error.__cause__
    return error


def _without_search_path(error: Exception) -> str:
    return str(error).partition("Config search path:")[0]


def _printable(typed: str) -> str:
    """What was typed in quotes, with escapes where it would not be one line."""
    return f"'{typed}'" if typed.isprintable() else repr(typed)


def _one_line(text: object) -> str:
    return " ".join(str(text).split())
