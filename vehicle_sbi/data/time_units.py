"""The unit in which a clock counts, as its usual step tells it where nobody says."""

FASTEST = (("ns", 9e5), ("us", 900.0), ("ms", 2.0))
"""Usual steps beyond which times are in a unit: a drive is sampled every 0.9 ms to 2 s."""


def guessed(usual_step: float) -> str:
    """The unit of times with this usual step [that unit]; `s` where seconds are plausible."""
    return next((unit for unit, least in FASTEST if usual_step > least), "s")
