"""How probable each explanation is: none, sets of effects, and something unknown, alone or beside known effects.

Probabilities follow from Laplace's evidence and a prior that is reluctant to add effects. Laws that no effect of the
catalogue has make *unknown* probable where they do better than effects, and so does what the best set leaves over, by
how often noise alone would leave as much. Further recordings, which nothing is fitted to, count by how likely each
model makes them.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float

from vehicle_sbi.mismatch.belief import Belief
from vehicle_sbi.mismatch.examine import LEVEL, Examined, Model
from vehicle_sbi.mismatch.fit import Fit, Observation
from vehicle_sbi.mismatch.foretell import foretold
from vehicle_sbi.mismatch.needed import needed
from vehicle_sbi.mismatch.support import unsupported

SURPRISE = 0.2  # exponent of the density of p-values under something unknown, SURPRISE p^(SURPRISE - 1)
SURPRISE_TOLD = 0.5  # the same for the p-value of what is foretold
FAILED = -1e3  # log likelihood of what cannot be simulated
DOUBTED = -1.0  # log likelihood of what is foretold, beyond the base model's, below which a set is doubted
BENEFIT = 0.1  # of the doubt: what is kept of its odds
TEMPER = 0.5  # power of the evidence where the best set leaves nothing over
LAPSE = 0.05  # probability that search or noise model fail, which is something unknown's too
TOLD_APART = 3  # digits of a probability
LEAST_P = 1e-9  # that counts as one


@dataclass(frozen=True)
class Explanation:
    """Sets of effects, the most probable first, beside the base model and the best one, which were examined.

    `unnamed` are models with a law that the catalogue does not have, the most probable first; `p_told` is how often
    the best one's parameters would seem to move as much from one recording to another, if anything was foretold;
    `sizes` names the parameters along which effects leave their nulls; `full` is the fit with every effect in;
    `doubtful` are sets of which an effect's size may as well be nothing, the likeliest first.
    """

    models: list[Model]
    unnamed: list[Model]
    base: Examined
    best: Examined
    belief: Belief
    p_told: float | None = None
    sizes: tuple[str, ...] = ()
    full: Fit | None = None
    doubtful: list[Model] = field(default_factory=list)

    def foretelling(self, further: Observation) -> "Explanation":
        """With what further recordings say of each model; as it is where the base model fails there.

        What even the best of them leaves over there counts as noise, which likelihoods are taken under.
        """
        base = foretold(self.base.model, further)
        if base is None or not self.detected:
            return self
        models = [*self.models, *self.unnamed, self.best.model]
        once = {id(model): model for model in models}  # the best one is among the others
        each = {key: foretold(model, further) for key, model in once.items()}
        found = [each[id(model)] for model in models]
        noise = max(1.0, min(one.left for one in (base, *found) if one is not None))
        told = [
            replace(model, told=FAILED if one is None else (one.log_likelihood - base.log_likelihood) / noise)
            for model, one in zip(models, found, strict=True)
        ]
        *others, best = told
        p_told = LEAST_P if found[-1] is None else found[-1].p_value
        named, unnamed = others[: len(self.models)], others[len(self.models) :]
        return replace(
            self, models=named, unnamed=unnamed, best=replace(self.best, model=best), p_told=p_told
        ).in_order()

    def supported(self) -> "Explanation":
        """With sets that hold an effect whose size may as well be nothing set aside."""
        kept, aside = list[Model](), list[Model]()
        for model in self.models:
            (aside if unsupported(model, self.sizes, self.temper) else kept).append(model)
        doubtful = sorted([*self.doubtful, *aside], key=lambda model: -model.weight(self.belief, self.temper))
        return replace(self, models=kept, doubtful=doubtful).in_order()

    @property
    def shares(self) -> list[tuple[Model, float]]:
        """All models with their probabilities: sets, those with a law, none, and what the best set leaves over."""
        models = (*self.models, *self.unnamed, self.base.model, self.best.model)
        return list(zip(models, self._shares.tolist(), strict=True))

    def in_order(self) -> "Explanation":
        """Sets by how probable they are alone, and only if something unknown is likelier than all of them, or they are
        alike in that, by how probable alone or beside something unknown; and what the catalogue does not have."""
        alone = 1.0 if self.known_leads else 0.0
        ranked = sorted(
            zip(self.models, self.probability, self.standing, strict=True),
            key=lambda one: (-alone * round(one[1], TOLD_APART), -one[2]),
        )
        unnamed = sorted(self.laws, key=lambda one: -one[1])
        return replace(self, models=[model for model, _, _ in ranked], unnamed=[model for model, _ in unnamed])

    @property
    def standing(self) -> list[float]:
        """How probable each set is, alone or beside something unknown."""
        beside = self.beside_unknown
        return [p + beside.get(model.effects, 0.0) for model, p in zip(self.models, self.probability, strict=True)]

    @property
    def single(self) -> dict[str, float]:
        """How probable it is that each effect is missing, whatever else is, the most probable first."""
        found: dict[str, float] = {}
        alone = ((model.effects, p) for model, p in zip(self.models, self.probability, strict=True))
        for effects, p in (*alone, *self.beside_unknown.items()):
            for effect in effects:
                found[effect] = min(found.get(effect, 0.0) + p, 1.0)
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    @cached_property
    def _shares(self) -> Float[np.ndarray, " k"]:
        """Probabilities of all sets, of all with a law, of none and of what is left over, in this order.

        Evidence is tempered, the prior is not: evidence takes the noise for exactly what it was modelled as, and so
        comes out too sure; the more so, the more the best set leaves over. What is unknown is as probable as what the
        best set leaves over, and how its parameters move from one recording to another, are surprising. What a right
        set adds to the base model does not harm it elsewhere; one that does is doubted.
        """
        models = (*self.models, *self.unnamed, self.base.model, self.best.model)
        weights = np.array([model.weight(self.belief, self.temper) for model in models])
        weights[: len(self.models)] += np.log([BENEFIT if doubted(model) else 1.0 for model in self.models])
        weights[-1] += np.log(self.belief.unknown) + _surprise(self.best.p_adequate, SURPRISE)
        if self.p_told is not None:
            weights[-1] += _surprise(self.p_told, SURPRISE_TOLD)
        shares = (1.0 - LAPSE) * np.exp(weights - np.logaddexp.reduce(weights))
        shares[-1] += LAPSE
        return shares

    @property
    def temper(self) -> float:
        """Power of the evidence: deviations as large as what is left over would have come out by chance."""
        return TEMPER / self.best.scores.excess

    @property
    def probability(self) -> list[float]:
        """Of each set of effects."""
        return self._shares[: len(self.models)].tolist()

    @property
    def laws(self) -> list[tuple[Model, float]]:
        """Models with a law that the catalogue does not have, and their probabilities."""
        return list(zip(self.unnamed, self._shares[len(self.models) : -2].tolist(), strict=True))

    @cached_property
    def beside_unknown(self) -> dict[tuple[str, ...], float]:
        """How probable it is that a set of known effects and something unknown are missing, the most probable first.

        The empty set is among them. Laws are fitted beside the best set of a size alone; beside the others they are
        taken to do as well. Where nothing explains what is left over, an effect is as probable as the full model needs
        it: whatever else is missing may be what it was found for.
        """
        found: dict[tuple[str, ...], float] = {}
        by_laws = [(model.effects, p, False) for model, p in self.laws]
        for effects, share, doubtful in [*by_laws, (self.best.model.effects, self.left, True)]:
            for stand_in, part in self._stand_ins(effects).items():
                for kept, p in self._kept(stand_in).items() if doubtful else ((stand_in, 1.0),):
                    found[kept] = found.get(kept, 0.0) + share * part * p
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def _stand_ins(self, effects: tuple[str, ...]) -> dict[tuple[str, ...], float]:
        """Sets as large as this one, by how probable they are among themselves; if there are none, what of it is not
        set aside."""
        alike = [model for model in self.models if len(model.effects) == len(effects)]
        if not alike:
            return {self._without_doubt(effects): 1.0}
        weight = np.array([model.weight(self.belief, self.temper) for model in alike])
        parts = np.exp(weight - np.logaddexp.reduce(weight))
        return {model.effects: float(part) for model, part in zip(alike, parts, strict=True)}

    def _without_doubt(self, effects: tuple[str, ...]) -> tuple[str, ...]:
        """Of a set that is set aside the effects whose sizes are not nothing."""
        aside = next((model for model in self.doubtful if model.effects == effects), None)
        nothing = [] if aside is None else unsupported(aside, self.sizes, self.temper)
        return tuple(effect for effect in effects if effect not in nothing)

    def _kept(self, effects: tuple[str, ...]) -> dict[tuple[str, ...], float]:
        """Of a set those that the full model needs: each subset with its probability."""
        found: dict[tuple[str, ...], float] = {(): 1.0}
        for effect in effects:
            p = self.needed.get(effect, 1.0)
            found = {kept: (1.0 - p) * q for kept, q in found.items()} | {
                (*kept, effect): p * q for kept, q in found.items()
            }
        return {kept: p for kept, p in found.items() if p > 0.0}

    @cached_property
    def needed(self) -> dict[str, float]:
        """How probable each effect is where all others may act too; empty without a full model."""
        return {} if self.full is None else needed(self.full, self.base.model.fit.simulator.space.names, self.temper)

    @property
    def left(self) -> float:
        """Probability of what the best set leaves over being something that no law explains either."""
        return float(self._shares[-1])

    @property
    def p_none(self) -> float:
        """That nothing is missing."""
        return float(self._shares[-2])

    @property
    def p_unknown(self) -> float:
        """That something is missing which no set of known effects explains."""
        return min(float(sum(self.beside_unknown.values())), 1.0)

    @property
    def known_leads(self) -> bool:
        """Whether sets of known effects alone are together as probable as that something unknown is missing."""
        return self.p_unknown <= sum(self.probability)

    @property
    def p_value(self) -> float:
        """How often noise alone would look as much as if something were missing."""
        return self.base.p_value

    @property
    def detected(self) -> bool:
        return self.p_value < LEVEL

    def indistinguishable(self, share: float = 0.9) -> list[tuple[str, ...]]:
        """The smallest set of explanations that holds `share` of the probability of all named ones."""
        standing = np.array(self.standing)
        order = np.argsort(-standing, kind="stable")
        held = np.cumsum(standing[order]) / max(float(standing.sum()), 1e-300)
        return [self.models[k].effects for k in order[: int(np.searchsorted(held, share)) + 1]]


def doubted(model: Model) -> bool:
    """Whether further recordings are less likely under the model than under the base model."""
    return model.told < DOUBTED


def _surprise(p: float, exponent: float) -> float:
    """Log density of a p-value under something unknown, against that of nothing."""
    return float(np.log(exponent) + (exponent - 1.0) * np.log(max(p, LEAST_P)))
