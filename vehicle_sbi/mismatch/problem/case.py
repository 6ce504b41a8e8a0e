"""What is to be diagnosed: a vehicle, the recordings that it is fitted to, and those that are held out."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from vehicle_sbi.data.masks import holdout, liveliest, liveliest_of
from vehicle_sbi.data.noise import FEWEST, DrawnProcessNoise, EstimatedNoise, Mixture
from vehicle_sbi.data.readers import RecordingFile
from vehicle_sbi.data.together import Read, check_once, read, under_own_names
from vehicle_sbi.data.windows import Windows, check_alike, joined, one_after_another
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.effect_prior import EffectPrior
from vehicle_sbi.inference.setup import Setup
from vehicle_sbi.mismatch.problem.observation import Observation
from vehicle_sbi.parameters import ParameterSpace

HELD_OUT = 0.25  # share of the recordings' time that is held out where no recording is
BLOCK_S = 10.0  # [s] of a block that is held out, or a window if that is longer
BUFFER_S = 1.0  # [s] beside it that is not fitted
MOST_SAMPLES = 60_000  # of the recordings together; of longer ones the liveliest stretches are used
MOST_READINGS = 120_000  # the same times channels
MOST_WINDOWS = 40  # into which recordings are cut for fitting; longer ones get longer windows
MOST_RECORDINGS = 40  # that are fitted; of more the liveliest are used, since each is a window at least
MANY = 12  # recordings from which on every fourth one is held out whole, where none is named
STIFFEST = 2.0  # step times rate: modes this fast are stable (to 2.78) and gone within a sample, at half the cost
START = 2.0  # times what smoothing leaves over, which lacks the slow part of autocorrelated noise, is a start's spread
NO_DRAWS = DrawnProcessNoise(Mixture(np.zeros(0), np.zeros(0)), Mixture(np.zeros(0), np.zeros(0)), False)


@dataclass(frozen=True)
class Case:
    """Observations to fit and to hold out, with what was read on the way.

    `warnings` are what recordings contradict, `wrong` those of them that say a channel is wrong; `naming` is the part
    of held-out recordings that helps to tell names apart; `held_out` has seen none of that.
    """

    name: str
    observation: Observation
    naming: Observation | None
    held_out: Observation
    held_out_names: tuple[str, ...]
    apart: bool
    notes: tuple[str, ...]
    warnings: tuple[str, ...]
    wrong: tuple[str, ...]
    inputs: dict[str, str]
    effect_prior: EffectPrior


@dataclass(frozen=True, kw_only=True)
class Diagnosis(Setup):
    """Which recordings are fitted and which are held out; a path is read as `recording` says, which stands alone too.

    Without held-out recordings, blocks of the others' time are held out, with a buffer around them; of many recordings
    every fourth one is. With held-out ones, half of their time helps to name what is missing and the other half proves
    it.
    """

    recording: RecordingFile
    recordings: Sequence[str | RecordingFile]
    heldout: Sequence[str | RecordingFile]
    effect_prior: EffectPrior = field(default_factory=EffectPrior)

    def prepare(self) -> Case:
        """Read everything; InputError for recordings that do not go together, a box without its effect's null, or noise
        that is stated: what is missing would have to explain what a misjudged noise does not."""
        if not isinstance(self.noise, EstimatedNoise):
            raise InputError("noise: a diagnosis estimates it from the recordings; leave it at noise=estimated")
        training, held, left_out = self._read()
        apart = bool(held)
        inputs = {path: digest for _, recording in (*training, *held) for path, digest in recording.inputs.items()}
        cut = replace(self, window_s=self._window_s(training, held))
        names = tuple(recording.name for _, recording in held)
        every = [recording for _, recording in (*training, *held)]
        warnings = tuple(f"{recording.name}: {line}" for recording in every for line in recording.warnings)
        wrong = tuple(f"{recording.name}: {line}" for recording in every for line in recording.wrong)
        if not held:
            training, held = cut.blocks(training)
            names = (f"blocks of {', '.join(recording.name for _, recording in training)}",)
        parts = [cut.windows(recording, file) for file, recording in training]
        space = self.space(parts[0])
        _check_nulls(space)
        if apart:
            others = [cut.windows(recording, file) for file, recording in held]
            clock = tuple(one_after_another([[part] for part in each]) for each in (parts, others))
        else:
            others = cut.of_blocks(held)
            clock = _shared_clock(parts, others)
        check_alike([*parts, *others], [part.recordings[0] for part in (*parts, *others)])
        observation = cut.observe(space, parts, clock[0])
        held_out = cut.observe(space, others, clock[1])
        if not apart:
            held_out = held_out.extended(replace(held_out.simulator, nominal=observation.simulator.nominal))
        naming, proving = halves(held_out)
        if not (apart and naming.anything and proving.anything):
            naming, proving = None, held_out
        return Case(
            name=f"{self.vehicle.name} from {', '.join(recording.name for _, recording in training)}",
            observation=observation,
            naming=naming,
            held_out=proving,
            held_out_names=names,
            apart=apart,
            notes=(*left_out, *self.unheeded(space), *observation.simulator.windows.notes),
            warnings=warnings,
            wrong=wrong,
            inputs=inputs,
            effect_prior=self.effect_prior,
        )

    def _window_s(self, training: Read, held: Read) -> float:
        """The length of windows [s] that is asked for, no longer than the blocks that are held out where no recording
        is; longer where there would be too many of them, but not for that alone longer than the shortest recording."""
        if not self.window_s > self.warmup_s:
            raise InputError(f"window_s = {self.window_s:g}; it must be longer than warmup_s = {self.warmup_s:g}")
        if not held:
            self._check_length(training)
        seconds = sum(recording.present_s for _, recording in (*training, *held))
        shortest = min(recording.present_s for _, recording in (*training, *held))
        few_s = seconds / MOST_WINDOWS
        return max(self.window_s, min(few_s, shortest)) if held else max(min(self.window_s, HELD_OUT * shortest), few_s)

    def _check_length(self, training: Read) -> None:
        """InputError for a recording too short to hold anything out.

        Of four blocks the second one is held out, and the two after it lack a buffer; in it and in those two a window
        has to last beyond its warm-up.
        """
        for _, recording in training:
            fitted_s = self.warmup_s + FEWEST / recording.rate
            least_s = max(fitted_s / HELD_OUT, 2.0 * (BUFFER_S + fitted_s))
            if recording.present_s < least_s:
                raise InputError(
                    f"{recording.source}: {recording.present_s:.3g} s are too short to hold anything out; it takes "
                    f"{least_s:.3g} s, or another recording as heldout=[…]"
                )

    def blocks(self, training: Read) -> tuple[Read, Read]:
        """Recordings with blocks of their time held out, and those blocks."""
        block_s = max(BLOCK_S, self.window_s)
        parts = [
            (file, holdout(recording, share=HELD_OUT, block_s=block_s, buffer_s=BUFFER_S))
            for file, recording in training
        ]
        return [(file, kept) for file, (kept, _) in parts], [(file, out) for file, (_, out) in parts]

    def of_blocks(self, held: Read) -> list[Windows]:
        """Held-out blocks as windows, of those recordings in whose blocks the car drives."""
        found, refused = list[Windows](), list[InputError]()
        for file, recording in held:
            try:
                found.append(self.windows(recording, file))
            except InputError as error:
                refused.append(error)
        if not found:
            raise refused[0]
        return found

    def _read(self) -> tuple[Read, Read, list[str]]:
        """Recordings to fit and to hold out with the files that they come from, as much of them as fits in memory, and
        what was left out or held out."""
        training, held = (read(given, self.recording) for given in (self.recordings or [self.recording], self.heldout))
        check_once(training, held)
        training, held, notes = _apart(training, held)
        kept = [
            [(file, liveliest(one, share)) for (file, one), share in zip(part, _shares(part), strict=True)]
            for part in under_own_names(training, held)
        ]
        return kept[0], kept[1], notes

    def observe(self, space: ParameterSpace, parts: Sequence[Windows], clock: Sequence[float]) -> Observation:
        """Recordings on one clock as one observation."""
        windows = joined(parts, [part.recordings[0] for part in parts], clock)
        windows = replace(windows, x0_std=START * windows.x0_std)
        simulator = self.simulator(space, windows, uniform_start=False, stiffest=STIFFEST)
        simulator = replace(simulator, process=NO_DRAWS)
        return Observation(simulator, np.where(windows.valid, windows.y, 0.0), estimated=True)


def _apart(training: Read, held: Read) -> tuple[Read, Read, list[str]]:
    """The liveliest recordings, of many every fourth one held out where none is named, and notes of both."""
    notes = list[str]()
    if not held and len(training) >= MANY:
        training, held = [one for k, one in enumerate(training) if k % 4], training[::4]
        notes.append(f"every fourth of {len(training) + len(held)} recordings is held out")
    chosen = list[Read]()
    for what, part in (("fitted", training), ("held out", held)):
        best = liveliest_of([recording for _, recording in part], MOST_RECORDINGS)
        chosen.append([part[k] for k in best])
        if len(best) < len(part):
            notes.append(f"{len(best)} of {len(part)} recordings are {what}: where steering and speed change most")
    return chosen[0], chosen[1], notes


def _shares(part: Read) -> list[float]:
    """How much of each recording is used, so that all of them fit in memory: the shortest are used whole."""
    channels = max((len(file.channels) for file, _ in part), default=1)
    left, shares = min(MOST_SAMPLES, MOST_READINGS / max(channels, 1)), [1.0] * len(part)
    in_order = sorted(range(len(part)), key=lambda k: len(part[k][1].t))
    for rank, k in enumerate(in_order):
        length = len(part[k][1].t)
        shares[k] = min(1.0, left / (len(part) - rank) / length)
        left -= shares[k] * length
    return shares


def _shared_clock(parts: Sequence[Windows], others: Sequence[Windows]) -> tuple[list[float], list[float]]:
    """The clock of recordings of which some windows are fitted and others are held out."""
    held = [[one for one in others if one.recordings[0] == part.recordings[0]] for part in parts]
    shifts = one_after_another([[part, *same] for part, same in zip(parts, held, strict=True)])
    return shifts, [shift for shift, same in zip(shifts, held, strict=True) for _ in same]


def halves(held: Observation) -> tuple[Observation, Observation]:
    """Every other window, the first one included, and the rest; of a single window its earlier and its later half."""
    windows, length = len(held.simulator.windows.t), held.simulator.windows.t.shape[1]
    part = np.arange(windows * length) // (length if windows > 1 else (length + 1) // 2)
    return held.masked(part % 2 == 0), held.masked(part % 2 == 1)


def _check_nulls(space: ParameterSpace) -> None:
    for p in space.parameters:
        if p.null is not None and not p.low <= p.null <= p.high:
            raise InputError(
                f"prior: {p.name} = [{p.low:g}, {p.high:g}] excludes {p.null:g}, where the effect vanishes; that is "
                "allowed for fitting, but a diagnosis asks whether the effect exists"
            )
