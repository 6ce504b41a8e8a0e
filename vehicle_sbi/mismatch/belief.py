"""What is believed before a recording is seen: how many effects are missing, and that it may be something unknown."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import comb, isclose, log

from vehicle_sbi.errors import InputError
from vehicle_sbi.physics.effects import CATALOGUE


@dataclass(frozen=True, kw_only=True)
class Belief:
    """`effects`: probability that none, one, two, … effects of the catalogue are missing, no set more likely than
    another of its size; `unknown`: odds of something outside the catalogue beside any of them that follows a law, or
    none; and of what even the likeliest set of all leaves over. They count in full, however evidence is tempered.

    By default what cars have: a simulation that lacks nothing is rare, and several effects are as common as one.

    Raises InputError where these are no probabilities or no odds.
    """

    effects: Sequence[float] = (0.03, 0.18, 0.36, 0.43)
    unknown: float = 0.3

    def __post_init__(self) -> None:
        numbers = [*self.effects, self.unknown]
        if any(isinstance(x, bool) or not isinstance(x, int | float) or not 0 < x < float("inf") for x in numbers):
            raise InputError(f"belief: effects {self.effects} and unknown {self.unknown} must be numbers above 0")
        if len(self.effects) < 2 or not isclose(sum(self.effects), 1.0, abs_tol=1e-6):
            raise InputError(
                f"belief: effects {self.effects} must be the probabilities of none, one, and so on, and sum to 1"
            )

    @property
    def most(self) -> int:
        """Effects at most in a set."""
        return len(self.effects) - 1

    def log_prior(self, effects: int, laws: int | None = None) -> float:
        """Of one set of so many effects; with one of so many laws that the catalogue does not have, where given.

        Laws are alike in groups: so many count as the square root of their number.
        """
        named = log(self.effects[effects]) - log(comb(len(CATALOGUE), effects))
        return named if laws is None else named + log(self.unknown) - 0.5 * log(laws)
