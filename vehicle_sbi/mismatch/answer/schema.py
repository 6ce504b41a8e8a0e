"""The answer's parts as typed values, those of verdict.json, with what is said of each in words."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from vehicle_sbi.inference.directions import SPAN
from vehicle_sbi.mismatch.estimation.estimate import Estimate
from vehicle_sbi.mismatch.hypotheses.block import Stretch, spoken
from vehicle_sbi.mismatch.selection.detection import Place


@dataclass(frozen=True)
class Named:
    """A set of effects, how probable it is that they are all that is missing, and that they and a discrepancy are.

    `parameters` are those of its effects, `acts` says when in which recording those act that come and go, or have a
    profile over that time.
    """

    effects: tuple[str, ...]
    probability: float
    beside_unknown: float
    parameters: dict[str, Estimate]
    acts: dict[str, list[Stretch]]
    foretold: None = None  # no longer told apart: recordings that help to name count in the probabilities

    @property
    def in_all(self) -> float:
        """How probable the set is, whether anything is unknown beside it or not."""
        return self.probability + self.beside_unknown

    @property
    def sizes(self) -> dict[str, Estimate]:
        """The parameters, but for those that say when an effect acts."""
        return {name: e for name, e in self.parameters.items() if name.split(".")[-1] not in SPAN}

    def of(self, effect: str) -> dict[str, Estimate]:
        """The sizes of one effect."""
        return {name: e for name, e in self.sizes.items() if name.split(".")[0] == effect}

    @property
    def acting(self) -> list[str]:
        """When its effects act that are tied to the clock, in words."""
        at = {name: spoken(within) for name, within in self.acts.items() if within}
        return [f"{name} acts {when}{self._give_or_take(name)}" for name, when in at.items()]

    def _give_or_take(self, effect: str) -> str:
        """How uncertain it is when an effect begins, and how long it lasts."""
        begun, lasting = (self.parameters.get(f"{effect}.{key}") for key in SPAN)
        if begun is None or lasting is None:
            return ""
        return f" (it begins ± {begun.std:.2g} s and lasts ± {lasting.std:.2g} s)"


@dataclass(frozen=True)
class Followed:
    """A law outside the catalogue: a target that follows a signal of the drive, its root mean square, the effects that
    it stands beside, how probable any error of the target is, and the share of its course that the signal explains."""

    target: str
    signal: str
    size: Estimate
    effects: tuple[str, ...]
    probability: float
    share: float


@dataclass(frozen=True)
class Outgrown:
    """Base parameters beyond the bounds (low, high) of their priors, the effects that they stand beside, in which part
    of the draws they are there, and the bound beyond which each mostly is."""

    parameters: dict[str, Estimate]
    prior: dict[str, tuple[float, float]]
    effects: tuple[str, ...]
    probability: float
    bound: dict[str, float]


@dataclass(frozen=True)
class Latent:
    """A force or an error over time: its mean in each stretch (from_s, to_s), the log likelihood that it gains, and
    when it is largest."""

    quantity: str
    unit: str
    from_s: list[float]
    to_s: list[float]
    size: list[float]
    gain: float
    within: list[Stretch]

    @property
    def largest(self) -> float:
        return max(self.size, key=abs)


@dataclass(frozen=True)
class Unknown:
    """What is missing where no known effect is it: laws that it seems to follow, the one that shows most first, base
    parameters at the bounds of their priors, which load or error over time, and the likeliest effects beside it."""

    effects: tuple[str, ...]
    laws: list[Followed]
    beyond_prior: list[Outgrown]
    over_time: Latent | None


@dataclass(frozen=True)
class Score:
    """A model's prediction of what was held out, so many `seconds` of it; CRPS in each channel's unit."""

    nrmse: dict[str, float]
    crps: dict[str, float]
    log_score: float
    coverage90: float
    seconds: float


@dataclass(frozen=True)
class Visible:
    """The parameter by which an effect would show first, and how far off its null it would have to be."""

    parameter: str
    size: float
    unit: str


@dataclass(frozen=True)
class Unsupported:
    """An effect that may as well not be missing, how probable it is, and the sizes that it would have."""

    effects: tuple[str, ...]
    parameters: dict[str, Estimate]
    probability: float


@dataclass(frozen=True)
class Verdict:
    """What the diagnosis says; its fields are those of verdict.json.

    `headline` is the answer in a line, `lines` are at most five more, `sentence` all of them. `explanations`: sets of
    effects, the likeliest first; `effects`: how probable it is that each is missing, whatever else is; `p_none`: that
    nothing is, `p_unknown`: that there is a discrepancy which no effect stands for and that can be told
    from nothing, `p_unknown_alone`: that there is, and no effect is missing;
    `share_explained`: what the likeliest set explains of the misfit; `indistinguishable`: groups of effects that stand
    for each other, `p_indistinguishable`: how probable it is that any of each is missing; `could_show` and `invisible`:
    which the recordings would have shown with a power of 80 %, and which they could not, beside others either;
    `cannot_act`: which change nothing here whatever their size, and why; `unsupported`: effects that may as well not be
    missing, the likeliest first; `warnings`: those of the notes that say why the fit may not be relied on;
    `wrong_recordings`: those of the warnings that say a channel is wrong (unit, sign, axis, gravity, clock).
    """

    schema: int
    headline: str
    lines: list[str]
    detected: bool
    p_value: float
    mismatch: list[Place]
    explanations: list[Named]
    effects: dict[str, float]
    p_none: float
    p_unknown: float
    p_unknown_alone: float
    share_explained: float | None
    unknown: Unknown | None
    indistinguishable: list[list[str]]
    p_indistinguishable: list[float]
    separating_experiment: str
    fit: dict[str, object]
    base_parameters: dict[str, object]
    could_show: dict[str, Visible]
    invisible: list[str]
    cannot_act: dict[str, str]
    unsupported: list[Unsupported]
    warnings: list[str]
    wrong_recordings: list[str]
    notes: list[str]
    sentence: str

    def as_json(self) -> dict[str, object]:
        return asdict(self)


def listed(effects: Sequence[str]) -> str:
    """A set of effects as it is spoken of."""
    return " with ".join(effects)
