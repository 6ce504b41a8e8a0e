"""The answer's parts as typed values, those of verdict.json, with what is said of each in words."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

from vehicle_sbi.inference.directions import SPAN
from vehicle_sbi.mismatch.latent import Latent
from vehicle_sbi.mismatch.locate import Stretch, spoken
from vehicle_sbi.rounding import mean_and_std


@dataclass(frozen=True)
class Place:
    """Where simulation and recording differ: times [s] of what is used of the recordings, one after another, and
    `within` each of them."""

    channel: str
    from_s: float
    to_s: float
    p_value: float
    share_of_misfit: float
    regime: str
    within: list[Stretch]


@dataclass(frozen=True)
class Estimate:
    """A parameter's posterior."""

    mean: float
    std: float
    q05: float
    q95: float
    unit: str


@dataclass(frozen=True)
class Named:
    """A set of effects, how probable it is that they are all that is missing, and that they and something unknown are,
    the size of its parameters, how much likelier it makes the recordings that help to name (log likelihood), and when
    in which recording those of its effects act that come and go, or have a profile over that time."""

    effects: tuple[str, ...]
    probability: float
    beside_unknown: float
    parameters: dict[str, Estimate]
    foretold: float | None
    acts: dict[str, list[Stretch]]

    @property
    def sizes(self) -> dict[str, Estimate]:
        """The parameters, but for those that say when an effect acts."""
        return {name: e for name, e in self.parameters.items() if name.split(".")[-1] not in SPAN}

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
    """A law outside the catalogue: a target that follows a signal of the drive, its size where the signal has its root
    mean square, the effects that it stands beside, how probable it is, and, if it sets in at a moment, when in which
    recording it acts and how uncertain [s] that moment is."""

    target: str
    signal: str
    size: Estimate
    effects: tuple[str, ...]
    probability: float
    acts: list[Stretch]
    start_std: float | None

    @property
    def sentence(self) -> str:
        """The law, in words."""
        beside = f" beside {listed(self.effects)}" if self.effects else ""
        size = quantity("", self.size).removeprefix(" = ")
        law = f"{self.target} that follows {self.signal}, {size} at its root mean square"
        if self.acts:
            law = f"{self.target} that {self.signal}, {size} {spoken(self.acts)} (it begins ± {self.start_std:.2g} s)"
        return f"The likeliest law outside the catalogue{beside}: {law}."


@dataclass(frozen=True)
class Outgrown:
    """Base parameters beyond the boxes (low, high) of their priors, the effects that they stand beside, and how
    probable it is."""

    parameters: dict[str, Estimate]
    prior: dict[str, tuple[float, float]]
    effects: tuple[str, ...]
    probability: float

    @property
    def sentence(self) -> str:
        """Where they would lie, in words."""
        beside = f" beside {listed(self.effects)}" if self.effects else ""
        boxes = {name: f"prior {low:.6g} to {high:.6g}" for name, (low, high) in self.prior.items()}
        found = [f"{quantity(name, e)} ({boxes[name]})" for name, e in self.parameters.items()]
        return (
            f"Likelier than any law outside the catalogue{beside}: {' and '.join(found)}; the prior is too narrow, or "
            "something that is not in the catalogue acts as if it were."
        )


@dataclass(frozen=True)
class Unknown:
    """What is missing where no known effect is it: laws, the likeliest first, base parameters that would lie beyond
    their priors, what load or error over time, and which known effects are likely to be missing beside it."""

    effects: tuple[str, ...]
    laws: list[Followed]
    beyond_prior: list[Outgrown]
    over_time: Latent | None

    @property
    def sentence(self) -> str:
        """The likeliest of them, and what it takes over time."""
        likeliest = sorted([*self.laws, *self.beyond_prior], key=lambda one: -one.probability)
        found: list[Followed | Outgrown | Latent] = [*likeliest[:1], *([self.over_time] if self.over_time else [])]
        return " ".join(one.sentence for one in found)


@dataclass(frozen=True)
class Score:
    """A model's prediction of what was held out; CRPS in each channel's unit."""

    nrmse: dict[str, float]
    crps: dict[str, float]
    log_score: float
    coverage90: float


@dataclass(frozen=True)
class Visible:
    """The parameter by which an effect would show first, and how far off its null it would have to be."""

    parameter: str
    size: float
    unit: str


@dataclass(frozen=True)
class Unsupported:
    """A set of effects that would explain something, if one of its sizes could not as well be nothing."""

    effects: tuple[str, ...]
    parameters: dict[str, Estimate]

    @property
    def sentence(self) -> str:
        return f"{listed(self.effects)} would do best, but may as well be nothing ({self.sizes})."

    @property
    def sizes(self) -> str:
        return "; ".join(quantity(name, e) for name, e in self.parameters.items())


@dataclass(frozen=True)
class Verdict:
    """What the diagnosis says; its fields are those of verdict.json. `effects`: how probable it is that each of them is
    missing, whatever else is; `whatever_else`: the same where every effect is free at once (empty where it was not
    asked); `share_explained`: what the likeliest set explains of the squared score of all that was
    found; `could_show` and `invisible`: which the recordings would have shown with a power of 80 %, and which they
    could not; `cannot_act`: which change nothing here whatever their size, and why; `unsupported`: sets that are not
    among the explanations because their sizes may as well be nothing, the likeliest first; `warnings`: those of the
    notes that say why the base model's fit may not be relied on."""

    schema: int
    detected: bool
    p_value: float
    mismatch: list[Place]
    explanations: list[Named]
    effects: dict[str, float]
    whatever_else: dict[str, float]
    p_none: float
    p_unknown: float
    share_explained: float | None
    unknown: Unknown | None
    indistinguishable: list[list[str]]
    separating_experiment: str
    fit: dict[str, object]
    base_parameters: dict[str, object]
    could_show: dict[str, Visible]
    invisible: list[str]
    cannot_act: dict[str, str]
    unsupported: list[Unsupported]
    warnings: list[str]
    notes: list[str]
    sentence: str

    def as_json(self) -> dict[str, object]:
        return asdict(self)


def quantity(name: str, e: Estimate) -> str:
    """`body_roll.gradient = 0.0081 ± 0.0004 rad/(m/s^2)`."""
    return f"{name} = {mean_and_std(e.mean, e.std)} {e.unit}".removesuffix(" 1")


def listed(effects: Sequence[str]) -> str:
    """A set of effects as it is spoken of."""
    return " with ".join(effects)
