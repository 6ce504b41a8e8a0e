"""From theta and a recording's inputs to measurements: what sbi calls a simulator.

A batch of simulations is a pure function of theta and of addresses (stream, round, index): the same numbers come out
whatever the size of the batch or the number of cores.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, fields, replace

import numpy as np
from jaxtyping import Float, Int

from vehicle_sbi.data.noise import DrawnProcessNoise, MeasurementNoise
from vehicle_sbi.data.windows import Windows
from vehicle_sbi.inference.spike_slab import SpikeAndSlab
from vehicle_sbi.parameters import ParameterSpace
from vehicle_sbi.physics.sensors import GROUPS, MEASUREMENTS
from vehicle_sbi.physics.simulation import FINISHED, SENSOR_FIELDS, Motions, batch_simulator
from vehicle_sbi.physics.single_track import DRIVES
from vehicle_sbi.rng import Stream, generator

STIFFNESSES = ("C_kappa_f", "C_kappa_r", "C_alpha_f", "C_alpha_r")
STATES = ("v_x", "v_y", "r")


@dataclass(frozen=True)
class Draws:
    """What is random in a simulation before its measurement: all that theta does not decide."""

    stiffness: Float[np.ndarray, "n draws 4"]  # [N, N/rad]
    inputs: Float[np.ndarray, "n draws 2"]  # relative, steering and torque
    initial: Float[np.ndarray, "n windows 3"]  # v_x, v_y [m/s], r [rad/s]
    effects: Float[np.ndarray, "n p"]  # as the columns of a SpikeAndSlab

    @classmethod
    def joined(cls, each: Sequence["Draws"]) -> "Draws":
        """Those of several simulations as those of one batch."""
        return cls(*(np.concatenate([getattr(one, f.name) for one in each]) for f in fields(cls)))


@dataclass(frozen=True, kw_only=True)
class Simulator:
    """A vehicle with free parameters, driven by the inputs of a recording and measured as it was.

    What it may have beside its model, `plausible`, is drawn anew in every simulation.
    """

    nominal: np.void
    space: ParameterSpace
    model: str
    drive: str
    windows: Windows
    process: DrawnProcessNoise
    noise: MeasurementNoise
    uniform_start: bool
    substeps: int | Int[np.ndarray, " windows"]  # of the integrator a sample, in all windows or in each
    seed: int
    plausible: SpikeAndSlab = field(default_factory=SpikeAndSlab)

    @property
    def alone(self) -> "Simulator":
        """The same without plausible effects."""
        return replace(self, plausible=SpikeAndSlab())

    def only(self, which: Int[np.ndarray, " k"]) -> "Simulator":
        """With some of its windows alone."""
        steps = np.full(len(self.windows.u), self.substeps)
        return replace(self, windows=self.windows.only(which), substeps=steps[which])

    @property
    def shape(self) -> tuple[int, int]:
        """(channels, samples) of a simulation."""
        return len(self.windows.channels), self.windows.t.size

    @property
    def nuisances(self) -> tuple[str, ...]:
        """Names of what is drawn in each simulation: stiffnesses, input gains, uncertain initial states, effects."""
        stiffness = STIFFNESSES if self.process.stiffness.std and not self.process.per_sample else ()
        inputs = ("steering", "torque") if self.process.inputs.std and not self.process.per_sample else ()
        initial = tuple(f"{name}_{w}" for w in range(len(self.windows.x0)) for name in self.uncertain_states)
        return stiffness + inputs + initial + tuple(slab.parameter.name for slab in self.plausible.slabs)

    @property
    def uncertain_states(self) -> tuple[str, ...]:
        """Which of a window's initial states are nuisances."""
        return tuple(name for name, std in zip(STATES, self.windows.x0_std, strict=True) if std > 0)

    @property
    def nuisance_box(self) -> tuple[Float[np.ndarray, " e"], Float[np.ndarray, " e"]]:
        """Lowest and highest `eta`: without end, but for those of plausible effects."""
        endless = np.full(len(self.nuisances) - len(self.plausible), np.inf)
        return np.concatenate([-endless, self.plausible.low]), np.concatenate([endless, self.plausible.high])

    def nuisance_draws(self, eta: Float[np.ndarray, "n e"]) -> Draws:
        """Draws at `eta`, each nuisance's distance from its mean in standard deviations; that of an effect's parameter
        from its null in units of its spread."""
        columns = dict(zip(self.nuisances, eta.T, strict=True))
        none = np.zeros(len(eta))
        nominal = np.array([self.nominal[name] for name in STIFFNESSES])
        mixture = self.process.stiffness
        stiffness = np.stack([mixture.mean + mixture.std * columns.get(name, none) for name in STIFFNESSES], -1)
        mixture = self.process.inputs
        inputs = np.stack([mixture.mean + mixture.std * columns.get(name, none) for name in ("steering", "torque")], -1)
        initial = np.repeat(self.windows.x0[None], len(eta), axis=0)
        for w in range(initial.shape[1]):
            for i, name in enumerate(STATES):
                initial[:, w, i] += self.windows.x0_std[i] * columns.get(f"{name}_{w}", none)
        effects = self.plausible.at(eta[:, eta.shape[1] - len(self.plausible) :])
        return Draws(np.nan_to_num(stiffness * nominal)[:, None], inputs[:, None], initial, effects)

    def _random(self, rng: np.random.Generator) -> Draws:
        """One simulation's draws, with a leading axis of one."""
        draws = self.windows.t.shape[1] if self.process.per_sample else 1
        nominal = np.nan_to_num(np.array([self.nominal[name] for name in STIFFNESSES]))
        stiffness = nominal * self.process.stiffness.sample((1, draws, 4), rng)
        inputs = self.process.inputs.sample((1, draws, 2), rng)
        size = (1, *self.windows.x0.shape)
        spread = rng.uniform(-np.sqrt(3), np.sqrt(3), size) if self.uniform_start else rng.standard_normal(size)
        initial = self.windows.x0 + self.windows.x0_std * spread
        return Draws(stiffness, inputs, initial, self.plausible.sample(rng))

    def _records(self, theta: Float[np.ndarray, "n d"], effects: Float[np.ndarray, "n p"]) -> np.ndarray:
        """Physical records with what is free and what the plausible effects have drawn."""
        space = ParameterSpace((*self.space.parameters, *self.plausible.parameters))
        return space.records(np.concatenate([theta, effects], axis=1), self.nominal)

    def run(
        self, theta: Float[np.ndarray, "n d"], draws: Draws, dtype: type[np.floating] = np.float64
    ) -> tuple[np.ndarray, np.ndarray]:
        """Noise-free measurements (n, channels, time), NaN where a simulation failed, and outcomes (n,)."""
        y = np.empty((len(theta), *self.shape), dtype)
        outcomes, records = np.zeros(len(theta), np.int64), self._records(theta, draws.effects)
        batch_simulator(self.model)(
            records,
            self._motions(records, draws),
            DRIVES[self.drive],
            GROUPS.index(self.windows.speed_group),
            self.windows.before,
            self.windows.u,
            draws.stiffness,
            draws.inputs,
            self.windows.rate,
            np.full(len(self.windows.u), self.substeps),
            draws.initial,
            np.array([MEASUREMENTS.index(name) for name in self.windows.channels]),
            np.array([GROUPS.index(name) for name in self.windows.groups]),
            y,
            outcomes,
        )
        return y, outcomes

    def _motions(self, records: np.ndarray, draws: Draws) -> Motions:
        """Differences by a sensor's parameter leave the motion as it is, which is then integrated once."""
        free = (*self.space.parameters, *self.plausible.parameters)
        if not any(name in SENSOR_FIELDS for p in free for name in p.fields):
            return Motions.each(len(records))
        return Motions.shared(records, DRIVES[self.drive], draws.stiffness, draws.inputs, draws.initial)

    def noise_free(self, theta: Float[np.ndarray, "n d"], eta: Float[np.ndarray, "n e"] | None = None) -> np.ndarray:
        """Measurements without noise (n, channels, time), nuisances at their means unless `eta` says otherwise."""
        return self.run(
            theta, self.nuisance_draws(np.zeros((len(theta), len(self.nuisances))) if eta is None else eta)
        )[0]

    def simulate(
        self, theta: Float[np.ndarray, "n d"], index: np.ndarray, *, stream: Stream, round: int = 0
    ) -> tuple[Float[np.ndarray, "n channels time"], np.ndarray]:
        """Noisy measurements, zero where a sample is masked, and outcomes; row i has the address index[i]."""
        if not len(index):
            return np.zeros((0, *self.shape), np.float32), np.zeros(0, np.int64)
        rngs = [generator(seed=self.seed, stream=stream, round=round, index=int(i)) for i in index]
        draws = Draws.joined([self._random(rng) for rng in rngs])
        y, outcomes = self.run(theta, draws, np.float32)
        for row, rng in zip(y, rngs, strict=True):
            row += self.noise.std(row) * self.noise.sample(row.shape, rng)
        np.copyto(y, np.float32(0.0), where=~self.windows.valid)
        return y, outcomes

    def with_noise(self, noise: MeasurementNoise) -> "Simulator":
        return replace(self, noise=noise)


def succeeded(outcomes: np.ndarray) -> np.ndarray:
    """Which simulations neither spun out nor left the finite numbers."""
    return outcomes == FINISHED
