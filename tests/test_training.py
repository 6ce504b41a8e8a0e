"""A round's training ends at the exact posterior of a problem that has one, whatever proposed the simulations."""

import numpy as np
import pytest
import torch
from sbi.inference.posteriors import DirectPosterior
from sbi.utils import BoxUniform
from scipy.stats import truncnorm
from test_estimator import TIME, Counting
from torch import Tensor, nn

from vehicle_sbi.errors import InputError
from vehicle_sbi.inference.estimator import Builder, Embedded, MaskedAutoregressiveFlow, NeuralSplineFlow, behind
from vehicle_sbi.inference.training import Batches, Fit, Npe, Simulations, Training, fit

# theta uniform in a box, x = theta + noise: the posterior is a Gaussian cut off by the box in each dimension.
LOW, HIGH = torch.tensor([0.0, -1.0]), torch.tensor([1.0, 1.0])
NOISE = torch.tensor([0.15, 0.2])
X_O = torch.tensor([[0.9, 0.1]])  # the first is cut off by the box
QUICK = Training(batch_size=100, learning_rate=5e-3, steps=600, stop_after_epochs=8, max_epochs=60)
FLOW = NeuralSplineFlow(hidden_features=20, num_transforms=2, num_bins=5)


def exact() -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of the posterior at X_O."""
    cut = [(bound - X_O[0]) / NOISE for bound in (LOW, HIGH)]
    law = truncnorm(cut[0].numpy(), cut[1].numpy(), loc=X_O[0].numpy(), scale=NOISE.numpy())
    return law.mean(), law.std()


def simulated(theta: Tensor, seed: int) -> Tensor:
    return theta + NOISE * torch.randn(theta.shape, generator=torch.Generator().manual_seed(seed))


def prior_draws(n: int, seed: int = 0) -> Tensor:
    return LOW + (HIGH - LOW) * torch.rand((n, 2), generator=torch.Generator().manual_seed(seed))


def trained(
    rounds: list[Simulations],
    training: Training = QUICK,
    build: Builder | None = None,
    *,
    prior: BoxUniform | None = None,
    seed: int = 0,
    round: int = 0,
    member: int = 0,
) -> Fit:
    prior = prior or BoxUniform(LOW, HIGH)
    return fit(
        prior,
        build or FLOW.builder(),
        rounds,
        training,
        seed=seed,
        round=round,
        member=member,
        seen=lambda epoch, loss: None,
    )


def posterior_of(found: Fit, prior: BoxUniform) -> DirectPosterior:
    posterior = DirectPosterior(found.estimator, prior)
    posterior.set_default_x(X_O)
    return posterior


def assert_exact(posterior: DirectPosterior, n: int) -> None:
    """Means within a fifth of a standard deviation, standard deviations within a fifth.

    A network of a few thousand simulations is off by about sqrt(weights per output / effective simulations), here a
    tenth; twice that. Sampling adds 1/sqrt(4000).
    """
    torch.manual_seed(0)
    samples = posterior.sample((n,), show_progress_bars=False).numpy()
    assert (samples >= LOW.numpy()).all()
    assert (samples <= HIGH.numpy()).all()
    mean, std = exact()
    assert (np.abs(samples.mean(axis=0) - mean) / std < 0.2).all()
    np.testing.assert_allclose(samples.std(axis=0), std, rtol=0.2)


def test_one_round_from_the_prior_finds_the_exact_posterior() -> None:
    prior, theta = BoxUniform(LOW, HIGH), prior_draws(2000)
    assert_exact(posterior_of(trained([Simulations(theta, simulated(theta, 1))], prior=prior), prior), 4000)


@pytest.mark.slow
@pytest.mark.parametrize("embedded", [False, True])
def test_the_corrected_loss_finds_the_same_posterior_from_a_proposal_that_is_not_the_prior(embedded: bool) -> None:
    """A second round from a posterior that is off: uncorrected, its density would be multiplied in once more."""
    prior, theta = BoxUniform(LOW, HIGH), prior_draws(1000)
    flow = MaskedAutoregressiveFlow(model="zuko_maf", hidden_features=20, num_transforms=3)
    build = flow.builder()
    if embedded:
        torch.manual_seed(0)
        build = behind(nn.Linear(2, 6), build)
    training = Training(batch_size=100, learning_rate=2e-3, stop_after_epochs=20, max_epochs=80, atoms=10)
    first = Simulations(theta, simulated(theta, 1))
    proposal = posterior_of(trained([first], QUICK, build, prior=prior), prior)
    proposal = proposal.set_default_x(X_O - 1.5 * NOISE)
    torch.manual_seed(7)
    theta = proposal.sample((2000,), show_progress_bars=False).detach()
    assert isinstance(proposal, DirectPosterior)
    second = Simulations(theta, simulated(theta, 2), proposal)
    if embedded:
        torch.manual_seed(0)
        build = behind(nn.Linear(2, 6), flow.builder())
    assert_exact(posterior_of(trained([first, second], training, build, prior=prior, round=1), prior), 4000)
    uncorrected = posterior_of(trained([Simulations(theta, second.x)], QUICK, prior=prior), prior)
    samples = uncorrected.sample((4000,), show_progress_bars=False).numpy()
    mean, std = exact()
    assert np.abs((samples.mean(axis=0) - mean) / std).max() > 0.2  # so that the law above means something


def test_a_fit_is_a_pure_function_of_its_data_and_its_address() -> None:
    theta = prior_draws(200)
    data = [Simulations(theta, simulated(theta, 1))]
    short = Training(batch_size=50, max_epochs=2)

    def losses(*, seed: int = 0, round: int = 0, member: int = 0) -> list[float]:
        torch.manual_seed(torch.seed() % 1000)  # what came before does not matter
        return trained(data, short, seed=seed, round=round, member=member).validation_loss

    assert losses() == losses()
    others = [losses(seed=1), losses(round=1), losses(member=1)]
    assert all(other != losses() for other in others)


@pytest.mark.parametrize("epochs", [2, 3])
def test_max_epochs_is_the_number_of_epochs(epochs: int) -> None:
    theta, seen = prior_draws(200), []
    data = [Simulations(theta, simulated(theta, 1))]
    found = fit(
        BoxUniform(LOW, HIGH), FLOW.builder(), data, Training(max_epochs=epochs), seed=0, round=0, member=0,
        seen=lambda epoch, loss: seen.append((epoch, loss)),
    )  # fmt: skip
    assert [epoch for epoch, _ in seen] == list(range(1, epochs + 1))
    assert [loss for _, loss in seen] == found.validation_loss
    assert len(found.training_loss) == epochs


def test_training_stops_when_it_no_longer_gains() -> None:
    theta = prior_draws(200)
    eager = Training(batch_size=50, stop_after_epochs=3, learning_rate=0.02)
    found = trained([Simulations(theta, simulated(theta, 1))], eager)
    best = int(np.argmin(found.validation_loss))
    assert len(found.validation_loss) - 1 - best == 3


def test_the_atomic_loss_embeds_each_x_once_and_is_sbis() -> None:
    """Ten atoms each, yet one row of the embedding per x; the loss is what sbi's own code makes of the same network."""
    generator = torch.Generator().manual_seed(0)
    theta, x = prior_draws(120), torch.randn(120, 2, TIME, generator=generator)
    prior, counting = BoxUniform(LOW, HIGH), Counting()
    build = behind(counting, NeuralSplineFlow(num_transforms=1, num_bins=3, hidden_features=8).builder())
    first = trained([Simulations(theta, x)], Training(max_epochs=2), build, prior=prior)
    proposal = DirectPosterior(first.estimator, prior).set_default_x(x[:1])
    trainer, losses = _two_round_trainer(prior, build, theta, x, proposal)
    outer = trainer._neural_net
    assert isinstance(outer, Embedded)
    masks = torch.ones(len(theta), 1)
    counting = outer.embedding
    assert isinstance(counting, Counting)
    counting.rows = 0
    with torch.no_grad():
        torch.manual_seed(5)
        ours = trainer._log_prob_proposal_posterior_atomic(theta, x, masks)
        assert counting.rows == len(x)
        assert trainer._neural_net is outer
        torch.manual_seed(5)
        stock = super(type(trainer), trainer)._log_prob_proposal_posterior_atomic(theta, x, masks)
        assert counting.rows > 5 * len(x)
    torch.testing.assert_close(ours, stock, rtol=1e-4, atol=1e-4)
    assert losses


def _two_round_trainer(prior, build, theta, x, proposal):
    losses: list[float] = []
    trainer = Npe(prior, build, lambda epoch, loss: losses.append(loss), 2)
    trainer.append_simulations(theta, x, proposal=None)
    trainer.append_simulations(theta, x, proposal=proposal)
    trainer.train(num_atoms=10, max_num_epochs=1, training_batch_size=60)
    return trainer, losses


def test_batches_are_disjoint_shuffled_and_leave_out_the_odd_rest() -> None:
    rows = torch.arange(10, 33)
    batches = Batches((torch.arange(100), 2 * torch.arange(100)), rows, 5)
    torch.manual_seed(0)
    seen = list(batches)
    assert len(seen) == len(batches) == 4
    first = torch.cat([a for a, _ in seen])
    assert set(first.tolist()) < set(rows.tolist())
    assert len(set(first.tolist())) == 20
    assert first.tolist() != sorted(first.tolist())
    assert all((b == 2 * a).all() for a, b in seen)
    assert torch.cat([a for a, _ in batches]).tolist() != first.tolist()
    assert [len(a) for a, _ in Batches((torch.arange(100),) * 2, rows, 1000)] == [23]


WRONG = {
    "members": ({"members": 0}, "members must be at least 1"),
    "batch": ({"batch_size": 1}, "batch_size and atoms at least 2"),
    "atoms": ({"atoms": 1}, "batch_size and atoms at least 2"),
    "rate": ({"learning_rate": 0.0}, "learning_rate positive"),
    "rate that is no number": ({"learning_rate": float("nan")}, "learning_rate positive"),
    "validation": ({"validation_fraction": 1.0}, "validation_fraction = 1; it must lie between 0 and 1"),
    "steps": ({"steps": 0}, "training.steps = 0; it must be at least 1"),
    "epochs": ({"max_epochs": 1}, "max_epochs"),
    "stop": ({"stop_after_epochs": 0}, "stop_after_epochs"),
    "clip": ({"clip_max_norm": 0.0}, "clip_max_norm"),
    "device": ({"device": "tpu"}, "unknown device 'tpu'; known: cpu, cuda"),
}
GPU = torch.cuda.is_available()


@pytest.mark.parametrize("case", WRONG)
def test_bad_training_is_refused(case: str) -> None:
    given, message = WRONG[case]
    with pytest.raises(InputError, match=message):
        Training(**given)


@pytest.mark.skipif(GPU, reason="there is a GPU")
def test_a_gpu_that_is_not_there_gets_one_line() -> None:
    with pytest.raises(InputError, match="device = cuda: PyTorch finds no CUDA GPU here"):
        Training(device="cuda")


@pytest.mark.skipif(not GPU, reason="no GPU")
def test_a_gpu_finds_the_exact_posterior_and_hands_it_to_the_processor() -> None:
    prior, theta = BoxUniform(LOW, HIGH), prior_draws(2000)
    found = trained([Simulations(theta, simulated(theta, 1))], prior=prior, training=Training(device="cuda"))
    assert {tensor.device.type for tensor in found.estimator.state_dict().values()} == {"cpu"}
    assert_exact(posterior_of(found, prior), 4000)


@pytest.mark.parametrize(("simulations", "epochs"), [(1000, 120), (5000, 69), (15_000, 23), (2_000_000, 2)])
def test_a_round_takes_its_steps_whatever_the_number_of_simulations(simulations: int, epochs: int) -> None:
    # 1500 steps over batches of 200 out of nine tenths: 4 an epoch is too few for the cap, then 22, 67 and 9000.
    assert Training().epochs(simulations) == epochs


def test_the_learning_rate_ends_at_zero() -> None:
    theta, rates = prior_draws(200), []
    torch.manual_seed(1)

    def seen(epoch: int, loss: float) -> None:
        rates.append(trainer.optimizer.param_groups[0]["lr"])

    trainer = Npe(BoxUniform(LOW, HIGH), FLOW.builder(), seen, 4)
    trainer.append_simulations(theta, simulated(theta, 1))
    trainer.train(max_num_epochs=3, learning_rate=1e-3, stop_after_epochs=10, training_batch_size=50)
    # After each of four epochs: half a cosine from 1e-3 to nothing.
    assert rates == pytest.approx([1e-3 * 0.5 * (1 + np.cos(np.pi * k / 4)) for k in range(1, 5)], abs=1e-12)
