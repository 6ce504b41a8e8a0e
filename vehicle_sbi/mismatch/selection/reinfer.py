"""The extended model inferred anew, by the same rounds of neural posterior estimation as any other model.

A diagnosis describes each model by a normal about its fit. Where a recording says little, that misses what a posterior
has: bounds, and parameters of which only a product is known (a force and its lever).
"""

from dataclasses import dataclass, replace

from vehicle_sbi.checkpoints import Checkpoints
from vehicle_sbi.inference.estimator import DensityEstimator
from vehicle_sbi.inference.features import Features
from vehicle_sbi.inference.proposal import draw
from vehicle_sbi.inference.rounds import Problem, Scheme, infer
from vehicle_sbi.inference.training import Training
from vehicle_sbi.mismatch.estimation.model import Model


@dataclass(frozen=True, kw_only=True)
class Reinference:
    """How an extended model is inferred; `samples` are drawn from its posterior."""

    features: Features
    estimator: DensityEstimator
    rounds: Scheme
    training: Training
    samples: int

    def inferred(self, model: Model, checkpoints: Checkpoints) -> Model:
        """The model with draws from its posterior; rounds that are kept there are not run again."""
        simulator, observed = model.fit.simulator, model.fit.observation.observed
        problem = Problem(simulator, observed, self.features, self.estimator, self.training)
        posterior = infer(problem, self.rounds, checkpoints).posterior
        return replace(model, posterior=draw(posterior, simulator.space, self.samples))
