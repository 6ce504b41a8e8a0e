"""Rounds of neural posterior estimation: propose parameters, simulate, train, and propose again.

Three schemes share the loop. CORRECTED proposes from the last posterior and corrects for it in the loss (NPE-C with
atoms; Greenberg et al. 2019). TRUNCATED proposes from the prior cut down to where the last posteriors have mass, which
needs no correction (Deistler et al. 2022). AMORTISED is a single round from the prior, good for any recording with the
same inputs. Each round is a pure function of the rounds before it and the study's seed, and is checkpointed when it is
done, so an interrupted study that starts again ends where an uninterrupted one does.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
import torch
from jaxtyping import Float
from sbi.inference import EnsemblePosterior
from sbi.inference.posteriors import DirectPosterior
from sbi.inference.posteriors.base_posterior import NeuralPosterior
from sbi.neural_nets.estimators.base import ConditionalDensityEstimator
from sbi.utils import BoxUniform
from torch import Tensor
from tqdm import tqdm

from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_atomically
from vehicle_sbi.inference.estimator import Builder, DensityEstimator, behind
from vehicle_sbi.inference.features import Features, Summary
from vehicle_sbi.inference.prior import box
from vehicle_sbi.inference.proposal import Support, acceptance, draw, inside, truncated_prior
from vehicle_sbi.inference.simulator import Simulator, succeeded
from vehicle_sbi.inference.training import Fit, Simulations, Training, fit
from vehicle_sbi.rng import Stream, generator, seed_torch

CHUNK = 500  # simulations whose series are in memory at once
PILOT = 1000  # simulations that normalise the features, as in the paper
FIDUCIAL_DRAWS = 5_000
LEAST_ACCEPTANCE = 1e-3


@dataclass(frozen=True)
class Problem:
    """What is to be inferred: a simulator, what was observed, and how series become features and densities."""

    simulator: Simulator
    observed: Float[np.ndarray, "channels time"]
    features: Features
    estimator: DensityEstimator
    training: Training

    @cached_property
    def prior(self) -> BoxUniform:
        """One object for all rounds: sbi tells rounds apart by the prior's identity."""
        return box(self.simulator.space)

    def builder(self) -> Builder:
        """A builder with a fresh embedding network."""
        return behind(self.features.network(*self.simulator.shape), self.estimator.builder())


@dataclass(frozen=True)
class Round:
    """All that a finished round leaves behind: what is saved, and what the next round starts from."""

    theta: Tensor
    fiducial: Tensor
    states: list[dict[str, Tensor]]
    x_o: Tensor
    training_loss: list[list[float]]
    validation_loss: list[list[float]]
    failed: int
    trained_on: int
    acceptance: float

    def save(self, path: Path) -> None:
        write_atomically(path, lambda file: torch.save(vars(self), file))

    @classmethod
    def load(cls, path: Path) -> "Round":
        try:
            return cls(**torch.load(path, weights_only=True))
        except Exception as error:
            raise InputError(f"{path}: no checkpoint of a round ({type(error).__name__}); delete it to redo it") from None


@dataclass(frozen=True)
class Inference:
    """Rounds that are done and their posteriors at x_o."""

    rounds: tuple[Round, ...]
    posteriors: tuple[NeuralPosterior, ...]

    @property
    def posterior(self) -> NeuralPosterior:
        return self.posteriors[-1]


class Scheme(Protocol):
    """What is configured as `rounds=...`: how many rounds of how many simulations, proposed from where."""

    @property
    def rounds(self) -> int: ...

    @property
    def simulations(self) -> int: ...

    def propose(self, problem: Problem, before: Inference, rng: np.random.Generator) -> Float[np.ndarray, "n d"]:
        """The parameters of the next round."""
        ...

    def training_set(self, theta: Sequence[np.ndarray], before: Inference) -> Sequence[np.ndarray]:
        """Which simulations of each round the next network is trained on, as masks."""
        ...

    def train(
        self, problem: Problem, data: Sequence[Simulations], before: Inference, *, member: int, seen
    ) -> Fit:
        """One member's network after this round."""
        ...


def _check_counts(name: str, rounds: int, simulations: int) -> None:
    if rounds < 1 or simulations < 50:
        raise InputError(f"rounds={name}: {rounds} rounds of {simulations} simulations; needs at least 1 round of 50")


@dataclass(frozen=True, kw_only=True)
class Corrected:
    """NPE-C: the last posterior proposes, the loss corrects for it, the network goes on from its last weights."""

    rounds: int = 5
    simulations: int = 5000

    def __post_init__(self) -> None:
        _check_counts("corrected", self.rounds, self.simulations)

    def propose(self, problem: Problem, before: Inference, rng: np.random.Generator) -> Float[np.ndarray, "n d"]:
        if not before.rounds:
            return truncated_prior(problem.simulator.space, (), self.simulations, rng)
        accepted = before.rounds[-1].acceptance
        if accepted < LEAST_ACCEPTANCE:
            raise RuntimeError(
                f"round {len(before.rounds)}: only {accepted:.2%} of the density lies inside the prior; "
                "use rounds=truncated, which cannot leak"
            )
        return draw(before.posterior, self.simulations)

    def training_set(self, theta: Sequence[np.ndarray], before: Inference) -> Sequence[np.ndarray]:
        return [np.ones(len(rows), dtype=bool) for rows in theta]

    def train(self, problem: Problem, data: Sequence[Simulations], before: Inference, *, member: int, seen) -> Fit:
        build = problem.builder()
        if before.rounds:
            last = before.rounds[-1]
            if last.x_o.shape == data[0].x[:1].shape:
                build = _continued(build, last.states[member])
            data = [data[0], *(Simulations(d.theta, d.x, before.posterior) for d in data[1:])]
        return _fit(problem, build, data, before, member=member, seen=seen)


@dataclass(frozen=True, kw_only=True)
class Truncated:
    """TSNPE: the prior cut down to the support of every posterior so far proposes; the plain likelihood is the loss.

    A network is trained afresh on all simulations that lie in the truncated prior, z-scored to it.
    """

    rounds: int = 5
    simulations: int = 5000

    def __post_init__(self) -> None:
        _check_counts("truncated", self.rounds, self.simulations)

    def propose(self, problem: Problem, before: Inference, rng: np.random.Generator) -> Float[np.ndarray, "n d"]:
        return truncated_prior(problem.simulator.space, self._supports(before), self.simulations, rng)

    def training_set(self, theta: Sequence[np.ndarray], before: Inference) -> Sequence[np.ndarray]:
        return [inside(self._supports(before), rows) for rows in theta]

    def train(self, problem: Problem, data: Sequence[Simulations], before: Inference, *, member: int, seen) -> Fit:
        everything = Simulations(torch.cat([d.theta for d in data]), torch.cat([d.x for d in data]))
        return _fit(problem, problem.builder(), [everything], before, member=member, seen=seen)

    def _supports(self, before: Inference) -> list[Support]:
        """The supports of all posteriors so far; the same ones each time, since each is seeded by its round."""
        supports = []
        for k, posterior in enumerate(before.posteriors):
            seed_torch(seed=before.rounds[k].trained_on, stream=Stream.PROPOSAL, round=k)
            supports.append(Support.of(posterior))
        return supports


@dataclass(frozen=True, kw_only=True)
class Amortised(Truncated):
    """A single round from the prior: less sharp, but one network for every recording with these inputs."""

    rounds: int = 1
    simulations: int = 25_000

    def __post_init__(self) -> None:
        _check_counts("amortised", self.rounds, self.simulations)
        if self.rounds != 1:
            raise InputError(f"rounds=amortised: rounds.rounds = {self.rounds}; an amortised posterior has one round")


def _fit(problem: Problem, build: Builder, data: Sequence[Simulations], before: Inference, *, member: int, seen) -> Fit:
    k = len(before.rounds)
    seed = problem.simulator.seed
    return fit(problem.prior, build, data, problem.training, seed=seed, round=k, member=member, seen=seen)


def _continued(build: Builder, state: dict[str, Tensor]) -> Builder:
    """A builder whose network starts from given weights."""

    def build_continued(theta: Tensor, x: Tensor) -> ConditionalDensityEstimator:
        estimator = build(theta, x)
        estimator.load_state_dict(state)
        return estimator

    return build_continued


def series(simulator: Simulator, theta: np.ndarray, round: int, rows: np.ndarray, summary: Summary, bar) -> tuple:
    """Features (rows, ...) and outcomes of some simulations of a round, made a chunk at a time."""
    x, outcomes = [], []
    for chunk in np.array_split(rows, max(1, -(-len(rows) // CHUNK))):
        y, outcome = simulator.simulate(theta[chunk], chunk, stream=Stream.SIMULATION, round=round)
        x.append(np.asarray(summary(y), dtype=np.float32))
        outcomes.append(outcome)
        bar.update(len(chunk))
    return np.concatenate(x), np.concatenate(outcomes)


def posterior_of(problem: Problem, round: Round) -> NeuralPosterior:
    """The posterior at x_o of a finished round, rebuilt from its weights."""
    d, members = len(problem.simulator.space), []
    for state in round.states:
        # Networks take their shapes from data; weights and z-scores are the saved ones.
        estimator = problem.builder()(torch.randn(64, d), torch.randn(64, *round.x_o.shape[1:]))
        estimator.load_state_dict(state)
        estimator.eval()
        members.append(DirectPosterior(estimator, problem.prior).set_default_x(round.x_o))
    return members[0] if len(members) == 1 else EnsemblePosterior(members).set_default_x(round.x_o)


def infer(problem: Problem, scheme: Scheme, checkpoints: Path, *, quiet: bool = False) -> Inference:
    """Run all rounds, each taken from its checkpoint where there is one."""
    done = Inference((), ())
    for k in range(scheme.rounds):
        path = checkpoints / f"round_{k}.pt"
        if not path.exists():
            one_round(problem, scheme, done, quiet=quiet).save(path)
        finished = Round.load(path)
        done = Inference((*done.rounds, finished), (*done.posteriors, posterior_of(problem, finished)))
    return done


def fiducial_point(problem: Problem, before: Inference) -> Float[np.ndarray, " d"]:
    """Where the features are centred: the prior's centre at first, then the last posterior's mean."""
    space = problem.simulator.space
    if not before.rounds:
        return (space.low + space.high) / 2
    return draw(before.posterior, FIDUCIAL_DRAWS).mean(axis=0)


def one_round(problem: Problem, scheme: Scheme, before: Inference, *, quiet: bool) -> Round:
    """Propose, simulate, train; a pure function of the rounds before and the seed."""
    simulator, k = problem.simulator, len(before.rounds)
    seed_torch(seed=simulator.seed, stream=Stream.PROPOSAL, round=k)
    fiducial = fiducial_point(problem, before)
    new = scheme.propose(problem, before, generator(seed=simulator.seed, stream=Stream.PROPOSAL, round=k))
    theta = [*(r.theta.numpy() for r in before.rounds), new]
    rows = [np.flatnonzero(mask) for mask in scheme.training_set(theta, before)]
    name = f"round {k + 1}/{scheme.rounds}"
    with tqdm(total=sum(map(len, rows)), desc=f"{name} simulating", unit="sim", disable=quiet, leave=False) as bar:
        summary = _summary(problem, scheme, theta, k, fiducial)
        made = [series(simulator, t, j, r, summary, bar) for j, (t, r) in enumerate(zip(theta, rows, strict=True))]
    good = [succeeded(outcomes) & np.isfinite(x).reshape(len(x), -1).all(axis=1) for x, outcomes in made]
    data = [
        Simulations(torch.as_tensor(t[r[g]], dtype=torch.float32), torch.as_tensor(x[g]))
        for t, r, (x, _), g in zip(theta, rows, made, good, strict=True)
    ]
    if sum(len(d.theta) for d in data) < 50:
        raise InputError(f"{name}: fewer than 50 simulations succeeded; the prior lies where the vehicle spins out")
    fits = []
    with tqdm(desc=f"{name} training", unit="epoch", disable=quiet, leave=False) as bar:
        for member in range(problem.training.members):

            def seen(epoch: int, loss: float) -> None:
                bar.set_postfix(validation_loss=f"{loss:.3f}", refresh=False)
                bar.update()

            fits.append(scheme.train(problem, data, before, member=member, seen=seen))
    return _finished(problem, new, fiducial, fits, summary, data, failed=int((~good[-1]).sum()))


def _summary(problem: Problem, scheme: Scheme, theta: Sequence[np.ndarray], k: int, fiducial: np.ndarray) -> Summary:
    """The round's features: refitted each round, or fixed from the first where networks go on from round to round."""
    at = k if problem.features.recentred or not isinstance(scheme, Corrected) else 0
    rows = np.arange(min(PILOT, len(theta[at])))
    pilot, outcomes = problem.simulator.simulate(theta[at][rows], rows, stream=Stream.SIMULATION, round=at)
    return problem.features.fit(problem.simulator, fiducial, pilot[succeeded(outcomes)])


def _finished(
    problem: Problem, theta: np.ndarray, fiducial: np.ndarray, fits: list[Fit], summary: Summary, data, failed: int
) -> Round:
    observed = np.where(problem.simulator.windows.valid, problem.observed, 0.0)[None]
    unsure = Round(
        theta=torch.as_tensor(theta),
        fiducial=torch.as_tensor(fiducial),
        states=[f.estimator.state_dict() for f in fits],
        x_o=torch.as_tensor(np.asarray(summary(observed), dtype=np.float32)),
        training_loss=[f.training_loss for f in fits],
        validation_loss=[f.validation_loss for f in fits],
        failed=failed,
        trained_on=sum(len(d.theta) for d in data),
        acceptance=1.0,
    )
    accepted = acceptance(posterior_of(problem, unsure), problem.simulator.space)
    return Round(**{**vars(unsure), "acceptance": accepted})
