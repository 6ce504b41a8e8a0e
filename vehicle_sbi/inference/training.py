"""One round's training: sbi's NPE-C with an embedding evaluated once for each x, and a live view of the loss.

The subclass replaces private methods of sbi 0.27, to which the project's dependency is therefore held.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, cast

import torch
from sbi.inference import NPE_C
from sbi.inference.posteriors import DirectPosterior
from sbi.neural_nets.estimators.base import ConditionalDensityEstimator, ConditionalEstimatorBuilder
from sbi.utils import BoxUniform
from torch import Tensor
from torch.distributions import Distribution
from torch.optim.lr_scheduler import CosineAnnealingLR

from vehicle_sbi.errors import InputError, unknown
from vehicle_sbi.inference.estimator import Builder, Embedded
from vehicle_sbi.rng import Stream, seed_torch

DEVICES = ("cpu", "cuda")
EpochSeen = Callable[[int, float], None]


class Batches:
    """Shuffled mini-batches by indexing tensors, which costs a tenth of collating rows; the odd rest is left out."""

    def __init__(self, tensors: Sequence[Tensor], rows: Tensor, batch_size: int) -> None:
        self.tensors, self.rows, self.batch_size = tensors, rows, min(batch_size, len(rows))

    def __len__(self) -> int:
        return len(self.rows) // self.batch_size

    def __iter__(self) -> Iterator[tuple[Tensor, ...]]:
        shuffled = self.rows[torch.randperm(len(self.rows))]
        for i in range(len(self)):
            rows = shuffled[i * self.batch_size : (i + 1) * self.batch_size]
            yield tuple(tensor[rows] for tensor in self.tensors)


class NoTracker:
    """sbi's tracker protocol without a log folder; the run folder keeps the losses."""

    log_dir = None

    def log_metric(self, name: str, value: float, step: int | None = None) -> None: ...

    def log_metrics(self, metrics: dict[str, float], step: int | None = None) -> None: ...

    def log_params(self, params: dict[str, Any]) -> None: ...

    def add_figure(self, name: str, figure: Any, step: int | None = None) -> None: ...

    def flush(self) -> None: ...


class Npe(NPE_C):
    """NPE-C with a learning rate that falls to zero as a cosine over `epochs`, on a device of torch's.

    It calls `seen(epoch, validation_loss)` after every epoch.
    """

    def __init__(self, prior: Distribution, build: Builder, seen: EpochSeen, epochs: int, device: str = "cpu") -> None:
        named = cast(
            ConditionalEstimatorBuilder[ConditionalDensityEstimator], build
        )  # sbi calls (theta, x) by position
        super().__init__(
            prior=prior, density_estimator=named, device=device, tracker=NoTracker(), show_progress_bars=False
        )
        self._seen, self._epochs = seen, epochs

    def get_dataloaders(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, starting_round=0, training_batch_size=200, validation_fraction=0.1, *args, **kwargs
    ):
        """Batches by index for training and validation, in place of sbi's loaders."""
        tensors = [tensor.to(self._device) for tensor in self.get_simulations(starting_round)]
        rows = torch.randperm(len(tensors[0]))
        training = int((1 - validation_fraction) * len(rows))
        self.train_indices, self.val_indices = rows[:training], rows[training:]
        return tuple(Batches(tensors, part, training_batch_size) for part in (self.train_indices, self.val_indices))

    def _get_losses(self, batch, loss_args):  # pyright: ignore[reportIncompatibleMethodOverride]
        """sbi's losses without its deep copy of the proposal for every batch."""
        theta, x, masks = batch
        shared: Any = loss_args
        return self._loss(theta, x, masks, shared.proposal, shared.calibration_kernel, shared.force_first_round_loss)

    def _log_prob_proposal_posterior_atomic(self, theta, x, masks):
        outer = self._neural_net
        if not isinstance(outer, Embedded):
            return super()._log_prob_proposal_posterior_atomic(theta, x, masks)
        embedded = outer.embed(x)
        self._neural_net = outer.inner
        try:
            return super()._log_prob_proposal_posterior_atomic(theta, embedded, masks)
        finally:
            self._neural_net = outer

    def _summarize_epoch(self, train_loss, val_loss, epoch_start_time, summarization_kwargs):
        super()._summarize_epoch(train_loss, val_loss, epoch_start_time, summarization_kwargs)
        if self.epoch == 0:
            self._schedule = CosineAnnealingLR(self.optimizer, self._epochs)
        self._schedule.step()
        self._seen(self.epoch + 1, float(val_loss))

    def _report_convergence_at_end(self, epoch: int, max_num_epochs: int) -> None:
        """Nothing: the run folder keeps the number of epochs."""


@dataclass(frozen=True, kw_only=True)
class Training:
    """How a network is trained in each round; `members` networks from different seeds make an ensemble.

    A round takes about `steps` gradient steps, whatever the number of its simulations, and at most `max_epochs`; it
    stops earlier where the validation loss has not improved for `stop_after_epochs`, and keeps the best epoch. It is
    trained on `device`, and comes back to the processor, where everything else is done.
    """

    batch_size: int = 200
    learning_rate: float = 3e-3
    steps: int = 1500
    stop_after_epochs: int = 15
    max_epochs: int = 120
    validation_fraction: float = 0.1
    clip_max_norm: float = 5.0
    atoms: int = 10
    discard_prior_samples: bool = False
    members: int = 1
    device: str = "cpu"

    def __post_init__(self) -> None:
        if self.device not in DEVICES:
            raise unknown("device", self.device, DEVICES, "training")
        if self.device == "cuda" and not torch.cuda.is_available():
            raise InputError("device = cuda: PyTorch finds no CUDA GPU here; device=cpu trains without one")
        if not (self.members >= 1 and self.batch_size >= 2 and self.atoms >= 2 and self.learning_rate > 0):
            raise InputError(
                "training: members must be at least 1, batch_size and atoms at least 2, learning_rate positive"
            )
        if self.steps < 1:
            raise InputError(f"training.steps = {self.steps}; it must be at least 1")
        if not (self.max_epochs >= 2 and self.stop_after_epochs >= 1 and self.clip_max_norm > 0):
            raise InputError("training: max_epochs must be at least 2, stop_after_epochs 1, and clip_max_norm positive")
        if not 0 < self.validation_fraction < 1:
            raise InputError(
                f"training.validation_fraction = {self.validation_fraction:g}; it must lie between 0 and 1"
            )

    def shortened(self, share: float) -> "Training":
        """The same with a share of the steps."""
        return replace(self, steps=max(1, round(share * self.steps)))

    def epochs(self, simulations: int) -> int:
        """Passes over the training part of that many simulations that make up `steps`, at least 2."""
        batches = max(1, int((1 - self.validation_fraction) * simulations) // self.batch_size)
        return min(self.max_epochs, max(2, -(-self.steps // batches)))


@dataclass(frozen=True)
class Simulations:
    """One round's parameters and features, and the posterior they were proposed by (None: the prior)."""

    theta: Tensor
    x: Tensor
    proposal: DirectPosterior | None = None


@dataclass(frozen=True)
class Fit:
    """A trained estimator and its loss curves."""

    estimator: ConditionalDensityEstimator
    training_loss: list[float]
    validation_loss: list[float]


def fit(
    prior: Distribution,
    build: Builder,
    rounds: Sequence[Simulations],
    training: Training,
    *,
    seed: int,
    round: int,
    member: int,
    seen: EpochSeen,
) -> Fit:
    """Train one network on all rounds; plain likelihood if every round came from the prior, else NPE-C's loss."""
    seed_torch(seed=seed, stream=Stream.TRAINING, round=round, index=member)
    epochs = training.epochs(sum(len(simulations.theta) for simulations in rounds))
    trainer = Npe(_on(training.device, prior), build, seen, epochs, training.device)
    for simulations in rounds:
        trainer.append_simulations(simulations.theta, simulations.x, proposal=simulations.proposal)
    estimator = trainer.train(
        num_atoms=training.atoms,
        training_batch_size=training.batch_size,
        learning_rate=training.learning_rate,
        validation_fraction=training.validation_fraction,
        stop_after_epochs=training.stop_after_epochs,
        max_num_epochs=epochs - 1,  # sbi runs one more
        clip_max_norm=training.clip_max_norm,
        discard_prior_samples=training.discard_prior_samples,
    )
    summary = trainer.summary
    return Fit(estimator.to("cpu"), list(summary["training_loss"]), list(summary["validation_loss"]))


def _on(device: str, prior: Distribution) -> Distribution:
    """The prior on a device; itself on the processor, since sbi tells rounds apart by its identity."""
    if device == "cpu":
        return prior
    box = cast(BoxUniform, prior).base_dist
    return BoxUniform(box.low.to(device), box.high.to(device), device=device)
