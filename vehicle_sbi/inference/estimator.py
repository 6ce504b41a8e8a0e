"""Density estimators: one frozen class for each, over sbi's `posterior_nn`."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

import torch
from sbi.neural_nets import posterior_nn
from sbi.neural_nets.estimators.base import ConditionalDensityEstimator
from torch import Tensor, nn

Builder = Callable[[Tensor, Tensor], ConditionalDensityEstimator]


class Embedded(ConditionalDensityEstimator):
    """A density estimator behind an embedding network that is evaluated once for each x.

    sbi's own wiring embeds x again for every atom of the atomic loss and for every theta at which a density is
    evaluated; with ten atoms that is most of the time of a round.
    """

    def __init__(self, embedding: nn.Module, inner: ConditionalDensityEstimator, condition_shape: torch.Size) -> None:
        super().__init__(net=inner, input_shape=inner.input_shape, condition_shape=condition_shape)
        self.embedding = embedding
        self.inner = inner

    def embed(self, condition: Tensor) -> Tensor:
        """Features (..., k) of conditions (..., *condition_shape)."""
        flat = condition.reshape(-1, *self.condition_shape)
        batch = condition.shape[: condition.dim() - len(self.condition_shape)]
        return self.embedding(flat).reshape(*batch, -1)

    def log_prob(self, input: Tensor, condition: Tensor, **kwargs: Any) -> Tensor:
        return self.inner.log_prob(input, self.embed(condition), **kwargs)

    def loss(self, input: Tensor, condition: Tensor, **kwargs: Any) -> Tensor:
        return self.inner.loss(input, self.embed(condition), **kwargs)

    def sample(self, sample_shape: torch.Size, condition: Tensor, **kwargs: Any) -> Tensor:
        return self.inner.sample(sample_shape, self.embed(condition), **kwargs)

    def sample_and_log_prob(self, sample_shape: torch.Size, condition: Tensor, **kwargs: Any) -> tuple[Tensor, Tensor]:
        return self.inner.sample_and_log_prob(sample_shape, self.embed(condition), **kwargs)


def behind(embedding: nn.Module | None, build: Builder) -> Builder:
    """The builder with its estimator behind `embedding`; x is standardised by the features then, not by sbi."""
    if embedding is None:
        return build

    def build_embedded(theta: Tensor, x: Tensor) -> ConditionalDensityEstimator:
        with torch.no_grad():
            features = embedding(x[:500])
        return Embedded(embedding, build(theta[:500], features), x.shape[1:])

    return build_embedded


class DensityEstimator(ABC):
    """What is configured as `estimator=...`: the conditional density q(theta | x)."""

    @abstractmethod
    def builder(self) -> Builder:
        """A function from (theta, x) to an untrained estimator, z-scored by them, as sbi's trainers want it."""


@dataclass(frozen=True, kw_only=True)
class NeuralSplineFlow(DensityEstimator):
    """Neural spline flow (Durkan et al. 2019), the paper's; `model` names sbi's implementation."""

    model: Literal["nsf", "zuko_nsf"] = "nsf"
    hidden_features: int = 50
    num_transforms: int = 3
    num_bins: int = 8

    def builder(self) -> Builder:
        return posterior_nn(
            self.model,
            hidden_features=self.hidden_features,
            num_transforms=self.num_transforms,
            num_bins=self.num_bins,
        )


@dataclass(frozen=True, kw_only=True)
class MaskedAutoregressiveFlow(DensityEstimator):
    """Masked autoregressive flow (Papamakarios et al. 2017); `model` names sbi's implementation."""

    model: Literal["maf", "zuko_maf"] = "maf"
    hidden_features: int = 50
    num_transforms: int = 5

    def builder(self) -> Builder:
        return posterior_nn(
            self.model,
            hidden_features=self.hidden_features,
            num_transforms=self.num_transforms,
        )


@dataclass(frozen=True, kw_only=True)
class MixtureDensityNetwork(DensityEstimator):
    """Mixture of Gaussians (Bishop 1994).

    Its corrected rounds use sbi's closed-form loss on the last round; behind an embedding network, the atomic one.
    """

    hidden_features: int = 50
    num_components: int = 10

    def builder(self) -> Builder:
        return posterior_nn("mdn", hidden_features=self.hidden_features, num_components=self.num_components)


@dataclass(frozen=True, kw_only=True)
class ZukoFlow(DensityEstimator):
    """Any other of zuko's flows, by zuko's name: nice, ncsf, sospf, naf, unaf, gf, bpf."""

    kind: Literal["nice", "ncsf", "sospf", "naf", "unaf", "gf", "bpf"]
    hidden_features: int = 50
    num_transforms: int = 5

    def builder(self) -> Builder:
        return posterior_nn(
            f"zuko_{self.kind}", hidden_features=self.hidden_features, num_transforms=self.num_transforms
        )
