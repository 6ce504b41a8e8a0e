"""Which left-out effects a recording could show at all, from which size, and which it cannot tell from each other.

All of it follows from the simulator, before the data are looked at. With J the whitened sensitivities of what is fitted
(parameters and nuisances, P their prior precision) and g those of a candidate effect at its null,

    M = I - J (J'J + P)^-1 J'          what fitting leaves of a change of the series
    retained = g'Mg / g'g              the share that is not absorbed by the fitted parameters
    size = 2.8 / sqrt(g'Mg)            seen with a power of 80 % by a two-sided test at 5 %
    coherence = |g_i'M g_j| / sqrt(g_i'M g_i  g_j'M g_j)
    absorbed = (J'J + P)^-1 J'g        how far the fitted parameters move instead, per unit of the effect
    taken_j = absorbed_j J_j'g / g'g   the share that parameter j takes; with all others and what is retained it is 1
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.sparse.csgraph import connected_components

from vehicle_sbi.data.noise import MeasurementNoise
from vehicle_sbi.inference.directions import Direction, left_out, null, slopes
from vehicle_sbi.inference.information import SEEN, sensitivity
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.design.cannot_act import cannot_act
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE

INSEPARABLE = 0.95  # coherence from which two candidates count as one
TAKING = 0.1  # share of an effect, from which a parameter is said to absorb it


@dataclass(frozen=True)
class Candidate:
    """What a recording could tell of one direction; sizes are in the parameter's unit.

    `absorbed` says by how many of its prior's standard deviations each fitted parameter moves for an effect of the
    smallest size that is seen (or of the prior's half width, if that is less); `taken` which share each
    of them takes, negative where it makes up for another one. What `acts` changes enough within its prior to be seen,
    if fitted parameters absorbed nothing and noise had no memory: though hidden, it may move these.
    """

    parameter: Parameter
    retained: float
    size: float
    absorbed: dict[str, float]
    taken: dict[str, float]
    acts: bool

    @property
    def effect(self) -> str:
        return self.parameter.name.split(".")[0]

    @property
    def least(self) -> str:
        """The smallest size that is seen, in two digits."""
        return f"{float(f'{self.size:.2g}'):g}"

    @property
    def share(self) -> float:
        """The smallest size that is seen, as a share of how far the effect's prior reaches."""
        rest = null(self.parameter)
        return self.size / max(self.parameter.high - rest, rest - self.parameter.low)

    @property
    def visible(self) -> bool:
        """Whether the smallest size that is seen lies within the effect's prior."""
        return self.share <= 1.0

    @property
    def absorbers(self) -> list[str]:
        """The fitted parameters that absorb it, the one that takes most of it first."""
        return sorted((p for p, part in self.taken.items() if abs(part) >= TAKING), key=lambda p: -abs(self.taken[p]))


@dataclass(frozen=True)
class Card:
    """All candidates of a recording, the coherence between them, the groups that it cannot tell apart, what is fitted,
    and why effects that change nothing here cannot."""

    candidates: tuple[Candidate, ...]
    coherence: Float[np.ndarray, "k k"]
    fitted: tuple[str, ...]
    cannot_act: dict[str, str]

    def groups(self) -> list[tuple[str, ...]]:
        """Sets of visible candidates that hang together by coherences above INSEPARABLE, the largest first."""
        names = [c.parameter.name for c in self.candidates]
        shown = [i for i, c in enumerate(self.candidates) if c.visible]
        close = self.coherence[np.ix_(shown, shown)] > INSEPARABLE
        _, label = connected_components(close, directed=False)
        sets = [tuple(names[i] for i, k in zip(shown, label, strict=True) if k == group) for group in set(label)]
        return sorted((group for group in sets if len(group) > 1), key=len, reverse=True)

    @property
    def alike(self) -> list[tuple[str, ...]]:
        """The effects of those sets that hold several."""
        found = [tuple(dict.fromkeys(name.split(".")[0] for name in group)) for group in self.groups()]
        return [group for group in found if len(group) > 1]

    def could_show(self) -> dict[str, Candidate]:
        """Each effect that would show, by the parameter with which it does at the smallest share of its prior, the
        smallest one first."""
        found: dict[str, Candidate] = {}
        for one in sorted((c for c in self.candidates if c.visible), key=lambda c: c.share):
            found.setdefault(one.effect, one)
        return found

    def invisible(self) -> list[str]:
        """Effects that act here and would not show, however large within their prior."""
        apart = self.could_show().keys() | self.cannot_act.keys() | {name.split(".")[0] for name in self.fitted}
        return [name for name in CATALOGUE if name not in apart]

    def visible(self, known: Sequence[Direction]) -> list[Direction]:
        """Of the directions that the candidates are of, those that could show here; what comes and goes may show at
        another time than it was tried at."""
        both = zip(known, self.candidates, strict=True)
        return [direction for direction, candidate in both if candidate.visible or direction.clocked]

    def acting(self, known: Sequence[Direction]) -> list[Direction]:
        """Of the directions that the candidates are of, those that could show or be absorbed by what is fitted."""
        both = zip(known, self.candidates, strict=True)
        return [direction for direction, candidate in both if candidate.acts or direction.clocked]


def card(simulator: Simulator, theta: Float[np.ndarray, " d"], found: Sequence[Direction] | None = None) -> Card:
    """What the recording behind `simulator` could show if the car is as theta says; `found` are all directions there,
    where they are known already."""
    at, found = sensitivity(simulator, theta), left_out(simulator, theta) if found is None else found
    noise, valid, changes = simulator.noise.of_sensor, simulator.windows.valid, slopes(simulator, theta, found)

    def white(changes: np.ndarray, noise: MeasurementNoise = noise) -> np.ndarray:
        return noise.whiten(np.nan_to_num(changes), noise.std(at.y), valid).reshape(len(changes), -1)

    spread = np.concatenate([simulator.space.prior_std, np.ones(len(at.jacobian) - len(theta))])
    J, g = white(at.jacobian * spread[:, None, None]), white(changes)
    most = np.linalg.norm(white(changes, noise.innovations), axis=1)
    moved = np.linalg.solve(J @ J.T + np.eye(len(J)), J @ g.T)  # (p, k), in the fitted parameters' spread
    cross = g @ g.T - g @ J.T @ moved
    raw, left = np.einsum("kt,kt->k", g, g), np.maximum(np.diag(cross), 0.0)
    with np.errstate(divide="ignore", invalid="ignore"):
        coherence = np.nan_to_num(np.abs(cross) / np.sqrt(np.outer(left, left)))
        size, retained = SEEN / np.sqrt(left), np.nan_to_num(left / raw)
        taken = np.nan_to_num(moved * (J @ g.T) / raw)
    names, rows = simulator.space.names, []
    for k, direction in enumerate(found):
        p = direction.parameter
        shown = min(size[k], 0.5 * (p.high - p.low))
        absorbed, part = (dict(zip(names, of[: len(theta), k].tolist(), strict=True)) for of in (shown * moved, taken))
        acts = bool(most[k] * max(direction.high, -direction.low) >= SEEN)
        rows.append(Candidate(p, float(retained[k]), float(size[k]), absorbed, part, acts))
    return Card(tuple(rows), coherence, names, cannot_act(simulator, theta, {d.effect for d in found}))
