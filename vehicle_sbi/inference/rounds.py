"""Rounds of neural posterior estimation: propose parameters, simulate, train, and propose again.

Three schemes share the loop. CORRECTED proposes from the last posterior and corrects for it in the loss (NPE-C with
atoms; Greenberg et al. 2019). TRUNCATED proposes from the prior cut down to where the last posteriors have mass, which
needs no correction (Deistler et al. 2022). AMORTISED is a single round from the prior, good for any recording with the
same inputs. Each round is a pure function of the rounds before it and the study's seed, and is checkpointed when it is
done, so an interrupted study that starts again ends where an uninterrupted one does.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import ClassVar, Protocol, cast

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

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.doubts import EXTRAPOLATED, TAIL, surprise, unlike
from vehicle_sbi.inference.estimator import Builder, DensityEstimator, behind
from vehicle_sbi.inference.features import Features, Summary
from vehicle_sbi.inference.information import Laplace, laplace
from vehicle_sbi.inference.proposal import Neighbourhood, Support, acceptance, box, draw, inside, truncated_prior
from vehicle_sbi.inference.simulator import Simulator, succeeded
from vehicle_sbi.inference.training import EpochSeen, Fit, Simulations, Training, fit
from vehicle_sbi.rng import Stream, generator, seed_torch

CHUNK = 500  # simulations whose series are in memory at once, if they are short
MOST_NUMBERS = 2**25  # of them; longer series are made fewer at a time
PILOT = 1000  # simulations that normalise the features, as in the paper
FIDUCIAL_DRAWS = 5_000
FIT_STARTS = 4  # of the fit that the first round proposes about
LEAST_ACCEPTANCE = 1e-3
LEAST_SIMULATIONS = 50


@dataclass(frozen=True)
class Problem:
    """What is to be inferred: a simulator, what was observed (zero where masked), and how series become densities."""

    simulator: Simulator
    observed: Float[np.ndarray, "channels time"]
    features: Features
    estimator: DensityEstimator
    training: Training

    @cached_property
    def prior(self) -> BoxUniform:
        """One object for all rounds: sbi tells rounds apart by the prior's identity."""
        return box(self.simulator.space)

    @cached_property
    def laplace(self) -> Laplace | None:
        """Laplace's approximation about the fit, if the model explains what was observed.

        None either with plausible effects free: each is there or not, so no normal about a fit holds the posterior.
        """
        simulator, space = self.simulator, self.simulator.space
        if len(simulator.plausible):
            return None
        rng = generator(seed=simulator.seed, stream=Stream.STUDY, index=3)
        drawn = rng.uniform(space.low, space.high, (FIT_STARTS - 1, len(space)))
        return laplace(simulator, self.observed, np.concatenate([(space.low + space.high)[None] / 2, drawn]))

    @property
    def neighbourhood(self) -> tuple[Neighbourhood, ...]:
        """Where a fit leaves the parameters: a single region, or none where the features say less than the fit uses."""
        found = self.laplace if self.features.efficient else None
        return () if found is None else (Neighbourhood(*found.marginal),)

    def builder(self) -> Builder:
        """A builder with a fresh embedding network."""
        return behind(self.features.network(*self.simulator.shape), self.estimator.builder())

    def rng(self, *, round: int) -> np.random.Generator:
        """The generator of a round's proposals."""
        return generator(seed=self.simulator.seed, stream=Stream.PROPOSAL, round=round)

    def fit(self, build: Builder, data: Sequence[Simulations], *, round: int, member: int, seen: EpochSeen) -> Fit:
        """One network trained on the given simulations."""
        seed = self.simulator.seed
        return fit(self.prior, build, data, self.training, seed=seed, round=round, member=member, seen=seen)


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
    surprise: float

    def save(self, checkpoints: Checkpoints, name: str) -> Path:
        return checkpoints.write(name, lambda file: torch.save(vars(self), file))

    @classmethod
    def load(cls, path: Path) -> "Round":
        try:
            return cls(**torch.load(path, weights_only=True))
        except Exception as error:
            raise InputError(
                f"{path}: no checkpoint of a round ({type(error).__name__}); delete it to redo it"
            ) from None


@dataclass(frozen=True)
class Inference:
    """Rounds that are done and their posteriors at x_o."""

    rounds: tuple[Round, ...]
    posteriors: tuple[NeuralPosterior, ...]

    @property
    def posterior(self) -> NeuralPosterior:
        return self.posteriors[-1]


@dataclass(frozen=True)
class Plan:
    """What a round simulates: its new parameters, and which rows of every round, new one last, train its network."""

    theta: Float[np.ndarray, "n d"]
    rows: list[np.ndarray]


class Scheme(Protocol):
    """What is configured as `rounds=...`: how many rounds of how many simulations, proposed from where."""

    @property
    def rounds(self) -> int: ...

    fresh: ClassVar[bool]  # whether each round trains a new network, under the plain likelihood

    def plan(self, problem: Problem, before: Inference) -> Plan: ...

    def train(self, problem: Problem, data: Sequence[Simulations], before: Inference, *, member: int, seen) -> Fit:
        """One member's network after this round, from all rounds' simulations."""
        ...


def _check_counts(name: str, rounds: int, simulations: int) -> None:
    if rounds < 1 or simulations < LEAST_SIMULATIONS:
        raise InputError(
            f"rounds={name}: {rounds} rounds of {simulations} simulations; at least 1 of {LEAST_SIMULATIONS} are needed"
        )


@dataclass(frozen=True, kw_only=True)
class Corrected:
    """NPE-C: the last posterior proposes, the loss corrects for it, the network goes on from its last weights."""

    rounds: int = 5
    simulations: int = 5000
    fresh: ClassVar[bool] = False

    def __post_init__(self) -> None:
        _check_counts("corrected", self.rounds, self.simulations)

    def plan(self, problem: Problem, before: Inference) -> Plan:
        k, space = len(before.rounds), problem.simulator.space
        if k == 0:
            theta = truncated_prior(space, (), self.simulations, problem.rng(round=0))
        elif before.rounds[-1].acceptance < LEAST_ACCEPTANCE:
            raise InputError(
                f"round {k}: only {before.rounds[-1].acceptance:.2%} of the density lies inside the prior; "
                "rounds=truncated cannot leak"
            )
        else:
            theta = draw(before.posterior, space, self.simulations)
        return Plan(theta, [np.arange(len(r.theta)) for r in before.rounds] + [np.arange(len(theta))])

    def train(self, problem: Problem, data: Sequence[Simulations], before: Inference, *, member: int, seen) -> Fit:
        build = problem.builder()
        if before.rounds:
            last = before.rounds[-1]
            if last.x_o.shape == data[0].x[:1].shape:
                build = _continued(build, last.states[member])
            data = [data[0], *(Simulations(d.theta, d.x, cast(DirectPosterior, before.posterior)) for d in data[1:])]
        return problem.fit(build, data, round=len(before.rounds), member=member, seen=seen)


@dataclass(frozen=True, kw_only=True)
class Truncated:
    """TSNPE: the prior cut down to the support of every posterior so far proposes; the plain likelihood is the loss.

    Where a fit leaves the parameters (`Problem.neighbourhood`) the first round begins already. A network is trained
    afresh on all simulations that lie in the truncated prior, z-scored to it. Rounds before the last only have to find
    the support: they take `early` of the training's steps and no ensemble; the last has `last` times their simulations.
    """

    rounds: int = 5
    simulations: int = 5000
    last: int = 1
    early: float = 0.4
    fresh: ClassVar[bool] = True

    def __post_init__(self) -> None:
        _check_counts("truncated", self.rounds, self.simulations)
        if self.last < 1 or not 0 < self.early <= 1:
            raise InputError(
                f"rounds=truncated: last = {self.last} must be at least 1, early = {self.early:g} above 0 and at most 1"
            )

    def plan(self, problem: Problem, before: Inference) -> Plan:
        return self._truncated(problem, before, problem.neighbourhood)

    def _truncated(self, problem: Problem, before: Inference, known: Sequence[Neighbourhood]) -> Plan:
        k, space = len(before.rounds), problem.simulator.space
        supports = [*known, *(Support.of(posterior, space) for posterior in before.posteriors)]
        simulations = self.simulations * (self.last if k == self.rounds - 1 else 1)
        theta = truncated_prior(space, supports, simulations, problem.rng(round=k))
        earlier = [np.flatnonzero(inside(supports, r.theta.numpy())) for r in before.rounds]
        return Plan(theta, [*earlier, np.arange(len(theta))])

    def train(self, problem: Problem, data: Sequence[Simulations], before: Inference, *, member: int, seen) -> Fit:
        everything = Simulations(torch.cat([d.theta for d in data]), torch.cat([d.x for d in data]))
        k = len(before.rounds)
        if k < self.rounds - 1:
            problem = replace(problem, training=problem.training.shortened(self.early))
        return problem.fit(problem.builder(), [everything], round=k, member=member, seen=seen)


@dataclass(frozen=True, kw_only=True)
class Amortised(Truncated):
    """A single round from the prior: less sharp, but one network for every recording with these inputs."""

    rounds: int = 1
    simulations: int = 25_000

    def __post_init__(self) -> None:
        _check_counts("amortised", self.rounds, self.simulations)
        if self.rounds != 1:
            raise InputError(f"rounds=amortised: rounds.rounds = {self.rounds}; an amortised posterior has one round")

    def plan(self, problem: Problem, before: Inference) -> Plan:
        return self._truncated(problem, before, ())


def _continued(build: Builder, state: dict[str, Tensor]) -> Builder:
    """A builder whose network starts from given weights."""

    def build_continued(theta: Tensor, x: Tensor) -> ConditionalDensityEstimator:
        estimator = build(theta, x)
        estimator.load_state_dict(state)
        return estimator

    return build_continued


def at_once(simulator: Simulator) -> int:
    """Simulations whose series are in memory at once."""
    return max(1, min(CHUNK, MOST_NUMBERS // int(np.prod(simulator.shape))))


def simulate_features(
    simulator: Simulator, theta: np.ndarray, rows: np.ndarray, *, round: int, summary: Summary, bar: tqdm
) -> tuple[np.ndarray, np.ndarray]:
    """Features (rows, ...) of some simulations of a round, and which of them succeeded, made a chunk at a time."""
    x, good = [], []
    for chunk in np.array_split(rows, max(1, -(-len(rows) // at_once(simulator)))):
        y, outcomes = simulator.simulate(theta[chunk], chunk, stream=Stream.SIMULATION, round=round)
        x.append(np.asarray(summary(y), dtype=np.float32))
        good.append(succeeded(outcomes) & np.isfinite(x[-1]).reshape(len(chunk), -1).all(axis=1))
        bar.update(len(chunk))
    return np.concatenate(x), np.concatenate(good)


def without_failures(theta: np.ndarray, x: np.ndarray, good: np.ndarray, *, drop: bool) -> Simulations:
    """A round's simulations as tensors, failed ones left out or given features that no success has.

    Leaving them out is exact under the plain likelihood; the corrected loss would lose the probability of success.
    """
    if drop:
        theta, x = theta[good], x[good]
    elif not good.all():
        beyond = x[good].max(axis=0) + 3.0 * np.ptp(x[good], axis=0) if good.any() else np.ones(x.shape[1:])
        x = np.where(good.reshape(-1, *[1] * (x.ndim - 1)), x, beyond).astype(np.float32)
    return Simulations(torch.as_tensor(theta, dtype=torch.float32), torch.as_tensor(x))


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


def infer(
    problem: Problem,
    scheme: Scheme,
    checkpoints: Checkpoints,
    *,
    quiet: bool = False,
    warn: Callable[[Sequence[str]], None] = lambda lines: None,
) -> Inference:
    """Run all rounds, each taken from its checkpoint where there is one; `warn` is told as soon as the recording proves
    to be unlike what is simulated."""
    done = Inference((), ())
    for k in range(scheme.rounds):
        name = file_of(k)
        path = checkpoints.kept(name) or one_round(problem, scheme, done, quiet=quiet).save(checkpoints, name)
        finished = Round.load(path)
        if finished.surprise > EXTRAPOLATED and all(one.surprise <= EXTRAPOLATED for one in done.rounds):
            warn([f"round {k + 1} of {scheme.rounds}: {unlike(finished.surprise)}"])
        done = Inference((*done.rounds, finished), (*done.posteriors, posterior_of(problem, finished)))
    return done


def file_of(k: int) -> str:
    """Where round k is kept in a run's folder."""
    return f"rounds/round_{k}.pt"


def fiducial_point(problem: Problem, before: Inference) -> Float[np.ndarray, " d"]:
    """Where the features are centred: the prior's centre at first, then the last posterior's mean."""
    space = problem.simulator.space
    if not before.rounds:
        return (space.low + space.high) / 2
    return draw(before.posterior, space, FIDUCIAL_DRAWS).mean(axis=0)


def one_round(problem: Problem, scheme: Scheme, before: Inference, *, quiet: bool) -> Round:
    """Propose, simulate, train; a pure function of the rounds before and the seed."""
    simulator, k = problem.simulator, len(before.rounds)
    name = f"round {k + 1}/{scheme.rounds}"
    seed_torch(seed=simulator.seed, stream=Stream.PROPOSAL, round=k)
    fiducial = fiducial_point(problem, before)
    plan = scheme.plan(problem, before)
    theta = [*(r.theta.numpy() for r in before.rounds), plan.theta]
    summary = fit_features(problem, theta, k if scheme.fresh or problem.features.recentred else 0, fiducial)
    data, failed, hidden = [], 0, quiet or None  # None: hidden where there is no terminal
    with tqdm(
        total=sum(map(len, plan.rows)), desc=f"{name} simulating", unit="sim", disable=hidden, leave=False
    ) as bar:
        for j, rows in enumerate(plan.rows):
            if not len(rows):  # an early round has none inside a narrow support
                continue
            x, good = simulate_features(simulator, theta[j], rows, round=j, summary=summary, bar=bar)
            data.append(without_failures(theta[j][rows], x, good, drop=scheme.fresh or j == 0))
            failed = int((~good).sum())
    if sum(len(d.theta) for d in data) < LEAST_SIMULATIONS:
        raise InputError(f"{name}: nearly all simulations fail; the prior lies where the vehicle spins out")
    with tqdm(desc=f"{name} training", unit=" epochs", disable=hidden, leave=False) as bar:

        def seen(epoch: int, loss: float) -> None:
            bar.set_postfix(validation_loss=f"{loss:.3f}", refresh=False)
            bar.update()

        members = 1 if scheme.fresh and k < scheme.rounds - 1 else problem.training.members
        fits = [scheme.train(problem, data, before, member=m, seen=seen) for m in range(members)]
    x_o = torch.as_tensor(np.asarray(summary(problem.observed[None]), dtype=np.float32))
    finished = Round(
        theta=torch.as_tensor(plan.theta),
        fiducial=torch.as_tensor(fiducial),
        states=[f.estimator.state_dict() for f in fits],
        x_o=x_o,
        training_loss=[f.training_loss for f in fits],
        validation_loss=[f.validation_loss for f in fits],
        failed=failed,
        trained_on=sum(len(d.theta) for d in data),
        acceptance=1.0,
        surprise=surprise(torch.cat([d.x for d in data]), x_o, tail=0.0 if len(simulator.plausible) else TAIL),
    )
    return replace(finished, acceptance=acceptance(posterior_of(problem, finished), simulator.space))


def fit_features(problem: Problem, theta: Sequence[np.ndarray], round: int, fiducial: np.ndarray) -> Summary:
    """The features about a fiducial point, normalised by pilot simulations of the given round."""
    rows = np.arange(min(PILOT, len(theta[round])))
    pilot, outcomes = problem.simulator.simulate(theta[round][rows], rows, stream=Stream.SIMULATION, round=round)
    good = succeeded(outcomes)
    if not good.any():
        raise InputError("every pilot simulation fails; the prior lies where the vehicle spins out")
    pilot = pilot if good.all() else pilot[good]  # it is large
    return problem.features.fit(problem.simulator, fiducial, theta[round][rows][good], pilot)
