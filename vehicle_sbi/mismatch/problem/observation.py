"""What was recorded, and the simulator that is driven as the car was."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float

from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.parameters import Parameter, ParameterSpace

Series = Float[np.ndarray, "channels time"]


@dataclass(frozen=True)
class Observation:
    """What was recorded (zero where masked), and the simulator that is driven as the car was.

    `estimated` says whether the noise is to be estimated, rather than known.
    """

    simulator: Simulator
    observed: Series
    estimated: bool

    def extended(self, simulator: Simulator) -> "Observation":
        return replace(self, simulator=simulator)

    def freeing(self, parameters: Sequence[Parameter]) -> "Observation":
        """The same with other parameters free."""
        return self.extended(replace(self.simulator, space=ParameterSpace(tuple(parameters))))

    @property
    def anything(self) -> bool:
        """Whether there is any sample to fit."""
        return bool(self.simulator.windows.valid.any())

    def masked(self, kept: Bool[np.ndarray, " time"]) -> "Observation":
        """With nothing but some of its samples."""
        windows = self.simulator.windows
        valid = windows.valid & kept
        simulator = replace(self.simulator, windows=replace(windows, valid=valid))
        return replace(self, simulator=simulator, observed=np.where(valid, self.observed, 0.0))
