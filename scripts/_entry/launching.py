"""Launching a script: Hydra composes its configuration, and a mistake in it ends in one line and status 2."""

from _entry import configuration, help
from _entry.command_line import spelled_out
from _entry.construction import check_construction
from _entry.failures import Failure, report, reported
from _entry.interruption import behind, leave
from _entry.output import flush_or_discard, leave_if_unread
from _entry.sentences import sentence
from _entry.slips import check_slips
from _entry.user_files import check_config_folders

import functools
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

Task = Callable[[DictConfig], object]


def launch(config_name: str) -> Callable[[Task], Callable[[], None]]:
    """Make a script's main function from one that takes its composed configuration, `conf/CONFIG_NAME.yaml`.

    The main function exits with status 2 after a wrong value, 130 after Ctrl-C, 143 after SIGTERM, and 141
    where nobody reads on what it prints.
    """

    def decorate(task: Task) -> Callable[[], None]:
        traceback_wanted = os.environ.get("HYDRA_FULL_ERROR") == "1"
        job = _job(task, traceback_wanted)

        @functools.wraps(task)
        def main() -> None:
            if help.wanted(sys.argv[1:]):
                print(help.text(task.__globals__["__doc__"] or "", config_name, Path(sys.argv[0]).stem))
                return
            os.environ["HYDRA_FULL_ERROR"] = "1"  # Hydra then raises, instead of printing in its own way
            os.environ["PYTHONPATH"] = os.pathsep.join(filter(None, sys.path))  # a sweep's jobs find what this finds
            try:
                check_slips(sys.argv[1:])
                sys.argv[1:] = spelled_out(sys.argv[1:])
                check_config_folders(sys.argv[1:])
                hydra.main(config_path=str(configuration.CONF), config_name=config_name, version_base=None)(job)()
                if not reported:
                    print(end="", flush=True)
            except (Exception, KeyboardInterrupt) as error:
                if interruption := behind(error):
                    leave(interruption)
                leave_if_unread(error)
                line = None if traceback_wanted else sentence(error)
                if line is None:
                    raise
                report(line)
            if reported:
                flush_or_discard()
                sys.exit(2)

        return main

    return decorate


def _job(task: Task, traceback_wanted: bool) -> Task:
    """The task with its construction checked first, a Failure for a wrong value, and no empty folder left behind."""
    script_pid = os.getpid()  # a job of a parallel sweep runs in another process

    @functools.wraps(task)
    def job(cfg: DictConfig) -> object:
        try:
            check_construction(OmegaConf.to_container(cfg, resolve=True))
            return task(cfg)
        except Exception as error:
            if interruption := behind(error):
                raise interruption from error
            leave_if_unread(error)
            line = None if traceback_wanted else sentence(error)
            if line is None:
                raise
            return Failure(_in_sweep() + line, script_pid)
        finally:
            with suppress(OSError):  # it holds something
                Path(HydraConfig.get().runtime.output_dir).rmdir()

    return job


def _in_sweep() -> str:
    """Which job of a sweep this is, to open its line with; empty outside a sweep."""
    cfg = HydraConfig.get()
    return f"job {' '.join(cfg.overrides.task)}: " if cfg.mode == RunMode.MULTIRUN else ""
