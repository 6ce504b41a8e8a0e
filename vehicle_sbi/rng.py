"""Randomness as a pure function of its address: one generator per (seed, stream, round, index).

A simulation's noise depends on its address alone, so results never depend on batch size or number of workers, and
an interrupted study that starts again draws the same numbers.
"""

from enum import IntEnum

import numpy as np


class Stream(IntEnum):
    """What a generator is for; streams of one study never overlap."""

    STUDY = 0
    TRUTH = 1
    PROPOSAL = 2
    SIMULATION = 3
    TRAINING = 4
    POSTERIOR = 5
    PREDICTIVE = 6


def generator(*, seed: int, stream: Stream, round: int = 0, index: int = 0) -> np.random.Generator:
    """The numpy generator at one address."""
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence((seed, int(stream), round, index))))


def seed_torch(*, seed: int, stream: Stream, round: int = 0, index: int = 0) -> None:
    """Set torch's global seed to the address; sbi draws from torch's global generator only."""
    import torch  # here, because it takes seconds to import and most of what needs a generator needs no torch

    address = np.random.SeedSequence((seed, int(stream), round, index))
    torch.manual_seed(int(address.generate_state(1, np.uint64)[0] >> 1))
