"""Density estimators are sbi's own; behind an embedding each x is embedded once, and the density stays the same."""

import copy
from collections.abc import Callable
from typing import Any

import pytest
import torch
import yaml
from conftest import ROOT
from hydra.utils import instantiate
from sbi.neural_nets import posterior_nn
from torch import Tensor, nn

from vehicle_sbi.inference.embedding import StridedCNN
from vehicle_sbi.inference.estimator import DensityEstimator, Embedded, NeuralSplineFlow, behind

D, TIME = 3, 64


class Counting(nn.Module):
    """A small embedding that counts how often it is called, and on how many rows."""

    def __init__(self, outputs: int = 4) -> None:
        super().__init__()
        self.linear = nn.Linear(2 * TIME, outputs)
        self.calls, self.rows = 0, 0

    def forward(self, y: Tensor) -> Tensor:
        self.calls, self.rows = self.calls + 1, self.rows + len(y)
        return torch.tanh(self.linear(y.flatten(1)))


@pytest.fixture
def data() -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    return torch.rand(80, D, generator=generator), torch.randn(80, 2, TIME, generator=generator)


def wirings(theta: Tensor, x: Tensor) -> tuple[Embedded, Any]:
    """Our estimator behind an embedding, and sbi's own with a copy of that embedding and of all weights."""
    torch.manual_seed(1)
    ours = behind(Counting(), NeuralSplineFlow(num_transforms=2, num_bins=4, hidden_features=10).builder())(theta, x)
    assert isinstance(ours, Embedded)
    stock = posterior_nn(
        "nsf", embedding_net=copy.deepcopy(ours.embedding), z_score_x="none", num_transforms=2, num_bins=4,
        hidden_features=10,
    )(theta, x)  # fmt: skip
    # sbi standardises x before its embedding (not at all here), ours what comes out of it.
    net: Any = stock.net
    inner: Any = ours.inner.net
    net._transform.load_state_dict(inner._transform.state_dict())
    net._distribution.load_state_dict(inner._distribution.state_dict())
    standardise = copy.deepcopy(inner._embedding_net)
    net._embedding_net = nn.Sequential(copy.deepcopy(ours.embedding), standardise)
    return ours, stock


def test_the_density_is_that_of_sbis_own_wiring(data: tuple[Tensor, Tensor]) -> None:
    theta, x = data
    ours, stock = wirings(theta, x)
    with torch.no_grad():
        torch.testing.assert_close(ours.log_prob(theta[None], x), stock.log_prob(theta[None], x))
        torch.testing.assert_close(ours.loss(theta, x), stock.loss(theta, x))
        several = torch.rand(5, 80, D, generator=torch.Generator().manual_seed(2))
        torch.testing.assert_close(ours.log_prob(several, x), stock.log_prob(several, x))


def test_draws_are_those_of_sbis_own_wiring(data: tuple[Tensor, Tensor]) -> None:
    ours, stock = wirings(*data)
    x = data[1][:4]
    drawn = []
    for estimator in (ours, stock):
        torch.manual_seed(3)
        drawn.append(estimator.sample(torch.Size((10,)), x).detach())
    assert drawn[0].shape == (10, 4, D)
    torch.testing.assert_close(drawn[0], drawn[1])
    both = []
    for estimator in (ours, stock):
        torch.manual_seed(3)
        both.append(estimator.sample_and_log_prob(torch.Size((10,)), x))
    torch.testing.assert_close(both[0], both[1])


CALLS: dict[str, tuple[Callable[[Embedded, Tensor, Tensor], object], int]] = {
    "log_prob of many theta": (lambda e, theta, x: e.log_prob(theta[:, None], x[:1]), 1),
    "log_prob of many theta for each x": (lambda e, theta, x: e.log_prob(theta.expand(7, -1, -1), x), 80),
    "loss": (lambda e, theta, x: e.loss(theta, x), 80),
    "sample": (lambda e, theta, x: e.sample(torch.Size((50,)), x[:2]), 2),
    "sample_and_log_prob": (lambda e, theta, x: e.sample_and_log_prob(torch.Size((50,)), x[:2]), 2),
}


@pytest.mark.parametrize("call", CALLS)
def test_each_x_is_embedded_once(data: tuple[Tensor, Tensor], call: str) -> None:
    ours, _ = wirings(*data)
    counting = ours.embedding
    assert isinstance(counting, Counting)
    counting.calls = counting.rows = 0
    do, rows = CALLS[call]
    with torch.no_grad():
        do(ours, *data)
    assert (counting.calls, counting.rows) == (1, rows)


def test_the_embedding_learns_with_the_flow(data: tuple[Tensor, Tensor]) -> None:
    ours, _ = wirings(*data)
    ours.loss(*data).mean().backward()
    trained = dict(ours.named_parameters())
    for name in ("embedding.linear.weight", "embedding.linear.bias"):
        gradient = trained[name].grad
        assert gradient is not None
        assert gradient.abs().max() > 0


def test_weights_survive_a_round_trip_into_a_new_network(data: tuple[Tensor, Tensor]) -> None:
    theta, x = data
    ours, _ = wirings(theta, x)
    other = behind(Counting(), NeuralSplineFlow(num_transforms=2, num_bins=4, hidden_features=10).builder())
    again = other(torch.randn(64, D), torch.randn(64, 2, TIME))
    with torch.no_grad():
        assert (again.log_prob(theta[None], x) != ours.log_prob(theta[None], x)).any()
        again.load_state_dict(ours.state_dict())
        torch.testing.assert_close(again.log_prob(theta[None], x), ours.log_prob(theta[None], x))


def test_without_an_embedding_the_builder_is_sbis_own() -> None:
    build = NeuralSplineFlow().builder()
    assert behind(None, build) is build


def test_a_strided_cnn_may_stand_before_the_flow(data: tuple[Tensor, Tensor]) -> None:
    theta, x = data
    estimator = behind(StridedCNN(channels=2, outputs=5), NeuralSplineFlow().builder())(theta, x)
    assert estimator.condition_shape == (2, TIME)
    assert torch.isfinite(estimator.loss(theta, x)).all()


@pytest.mark.parametrize("name", sorted(file.stem for file in (ROOT / "conf/estimator").glob("*.yaml")))
def test_every_configured_estimator_builds_evaluates_and_samples(name: str) -> None:
    estimator = instantiate(yaml.safe_load((ROOT / f"conf/estimator/{name}.yaml").read_text()))
    assert isinstance(estimator, DensityEstimator)
    generator = torch.Generator().manual_seed(0)
    theta, x = torch.rand(60, D, generator=generator), torch.randn(60, 5, generator=generator)
    density = estimator.builder()(theta, x)
    loss = density.loss(theta, x)
    assert loss.shape == (60,)
    assert torch.isfinite(loss).all()
    loss.mean().backward()
    if name != "zuko_unaf":  # whose inverse is found by bisection, one call in seconds
        assert density.sample(torch.Size((2,)), x[:1]).shape == (2, 1, D)


@pytest.mark.parametrize("name", sorted(file.stem for file in (ROOT / "conf/estimator").glob("*.yaml")))
def test_every_configured_estimator_is_rebuilt_from_its_weights_alone(name: str) -> None:
    """Permutations, masks and z-scores included, as a checkpoint does it: on data of another law."""
    estimator = instantiate(yaml.safe_load((ROOT / f"conf/estimator/{name}.yaml").read_text()))
    theta, x = torch.rand(60, D), torch.randn(60, 5)
    density, again = (estimator.builder()(a, b) for a, b in ((theta, x), (torch.randn(64, D), 3 * torch.randn(64, 5))))
    with torch.no_grad():
        for parameter in density.parameters():
            parameter.add_(0.1 * torch.randn_like(parameter))
        again.load_state_dict(density.state_dict())
        torch.testing.assert_close(again.eval().log_prob(theta[None], x), density.eval().log_prob(theta[None], x))
