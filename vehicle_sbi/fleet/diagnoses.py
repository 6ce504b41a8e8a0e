"""A diagnosis for each vehicle of a fleet, each in the run folder that the same words would give it alone."""

import json
import shutil
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_text
from vehicle_sbi.fleet.attended import attended
from vehicle_sbi.fleet.engine import Engine, each
from vehicle_sbi.fleet.vehicles import Member
from vehicle_sbi.quoting import quoted
from vehicle_sbi.report import manifest

VERDICT = "verdict.json"


@dataclass(frozen=True, kw_only=True)
class Job:
    """A vehicle to diagnose by `script` into `folder`, with options of a diagnosis, within `timeout_s` [s]."""

    member: Member
    folder: Path
    script: Path
    options: tuple[str, ...] = ()
    timeout_s: float = 1800.0

    @property
    def words(self) -> list[str]:
        return [*self.member.words, *self.options, f"hydra.run.dir={quoted(str(self.folder))}"]

    @property
    def log(self) -> Path:
        """What the diagnosis prints."""
        return self.folder.with_name(f"{self.folder.name}.log")

    @property
    def account(self) -> Path:
        """With which words it was asked, how it ended, and how long it took."""
        return self.folder.with_name(f"{self.folder.name}.json")


@dataclass(frozen=True)
class Outcome:
    """How a diagnosis ended: whether there is a verdict, why not or of which version, and after how long [s]."""

    answered: bool
    reason: str
    seconds: float


def diagnosed(job: Job) -> Outcome:
    """The diagnosis, unless it stands already: asked with the same words, of files that have not changed since.

    Where one of its files has changed, what stands in its folder is of no use, and is removed.
    """
    if (known := _standing(job)) is not None:
        return known
    if _outdated(job):
        shutil.rmtree(job.folder)
    begun = time.monotonic()
    status = attended(job.script, job.words, job.log, job.timeout_s)
    answered = status == 0 and (job.folder / VERDICT).is_file()
    outcome = Outcome(answered, "" if answered else _reason(job.log), round(time.monotonic() - begun, 1))
    write_text(job.account, json.dumps({"words": job.words, **vars(outcome)}, indent=1) + "\n")
    return outcome


def fleet(
    members: Sequence[Member], folder: Path, engine: Engine, *, script: Path, options: Sequence[str], timeout_s: float
) -> Iterator[tuple[Member, Outcome]]:
    """Every vehicle with the outcome of its diagnosis in FOLDER/NAME, as they are done."""
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    jobs = [
        Job(member=one, folder=folder / one.name, script=script, options=tuple(options), timeout_s=timeout_s)
        for one in members
    ]
    yield from ((job.member, outcome) for job, outcome in each(engine, diagnosed, jobs))


def _standing(job: Job) -> Outcome | None:
    """What an earlier start has found with the same words, if files and results are as it left them."""
    try:
        account, made = json.loads(job.account.read_bytes()), manifest.read(job.folder)
        intact = all(manifest.intact(Path(file), sealed) for file, sealed in made["inputs"].items())
        whole = all(manifest.intact(job.folder / file, sealed) for file, sealed in made["files"].items())
        if account["words"] == job.words and made["status"] == "complete" and intact and whole:
            other = "" if made["code"] == manifest.code() else "by another version; remove its folder to do it anew"
            return Outcome(True, other, account["seconds"])
    except (OSError, ValueError, LookupError, TypeError, InputError):
        pass
    return None


def _outdated(job: Job) -> bool:
    """Whether the folder holds a run, asked with the same words, of files that have changed since.

    One that was killed has left no account of its words. A file that is gone for now changes nothing.
    """
    try:
        asked = json.loads(job.account.read_bytes())["words"] if job.account.exists() else job.words
        inputs = {Path(file): sealed for file, sealed in manifest.read(job.folder)["inputs"].items()}
        return asked == job.words and any(one.exists() and not manifest.intact(one, inputs[one]) for one in inputs)
    except (OSError, ValueError, LookupError, TypeError, InputError):
        return False


def _reason(log: Path) -> str:
    """The line with which a diagnosis has ended."""
    lines = [line.strip() for line in log.read_text(errors="replace").splitlines() if line.strip()]
    said = [line for line in lines if line.startswith("error: ")] or lines[-1:]
    return said[-1].removeprefix("error: ") if said else "it was killed"
