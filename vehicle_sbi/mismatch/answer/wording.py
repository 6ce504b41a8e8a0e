"""The answer in words: a headline of at most 25 words, and at most five lines after it."""

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from vehicle_sbi.inference.directions import null
from vehicle_sbi.inference.simulator import Simulator
from vehicle_sbi.mismatch.answer.schema import Outgrown, Unknown, Verdict
from vehicle_sbi.mismatch.design.identifiability import Candidate, Card
from vehicle_sbi.mismatch.estimation.estimate import Estimate, quantity
from vehicle_sbi.mismatch.hypotheses.block import spoken, throughout
from vehicle_sbi.mismatch.selection.detection import Place
from vehicle_sbi.mismatch.selection.predictive import Prediction
from vehicle_sbi.mismatch.selection.score_test import DRAWS
from vehicle_sbi.physics.effects import EFFECT_PARAMETERS
from vehicle_sbi.rounding import mean_and_std, rounded
from vehicle_sbi.words import enumerated

NAMED = 0.5  # probability from which an effect is named
WORDS = 25  # of a headline at most
IN_HEADLINE, IN_LINE = 4, 5  # effects, and sizes, that are spelled out at most
RIVAL = 0.5  # of the likeliest set's probability, from which another is about as likely
MOVED = 1.0  # standard deviations by which a base parameter moves, from which it is worth saying
PARAMETERS = 3  # that are said to have moved at most
HARDLY_COVERED = 0.75  # share of the 90 % band, below which what was held out is not what the model predicts
EXAMPLES = 3  # effects that are named of those that would have shown
FOLLOWS = 0.5  # share of a course that a signal explains, from which it is said to follow it
SURE = 2.0  # standard deviations of what is left over, from which it is said what it acts on
LONGER = 1 / 3  # of its width, by which a box that is too narrow is to reach further
TOO_SMALL = "Left over: something unknown, too small to tell which force or sensor it is."

FACTORS = {  # parameters that multiply what a vehicle file states: fields of its record
    "friction_level.factor": "mu",
    "yaw_inertia.factor": "I_z_stated",
    "wheel_radius.front": "R_f",
    "wheel_radius.rear": "R_f",
}
ADDED = {"payload.mass": "m"}  # those that add to it


@dataclass(frozen=True)
class Context:
    """What the words need beside the answer: the base model's simulator, what the recordings could show, predictions,
    and whether recordings and base fit may be relied on."""

    simulator: Simulator
    seen: Card
    predictions: Mapping[str, Prediction]
    trusted: bool


def headline(answer: Verdict, *, trusted: bool) -> str:
    """What is missing, in at most 25 words."""
    begun = _begun(answer, trusted=trusted)
    if not answer.detected:
        return f"{begun}Nothing is missing as far as these recordings can tell ({spoken_p(answer.p_value)})."
    named, unknown = [*_named(answer)], answer.p_unknown if answer.p_unknown > NAMED else 0.0
    if not named:
        differ = f"Simulation and recording differ ({spoken_p(answer.p_value)})"
        return f"{begun}{differ}, and no known effect explains it for certain."
    tried = (_missing(begun, named, spelled, unknown) for spelled in range(min(len(named), IN_HEADLINE), 0, -1))
    return next((said for said in tried if len(said.split()) <= WORDS), _missing(begun, named, 1, unknown))


def _begun(answer: Verdict, *, trusted: bool) -> str:
    """What has to be known before anything else: that recordings look wrong, on which any fit is doubtful, or else that
    the fit is, of which something is said to be missing."""
    if answer.wrong_recordings:
        return "The recordings look wrong (see the warnings). "
    return "The base fit is doubtful. " if answer.detected and not trusted else ""


def spoken_p(p_value: float) -> str:
    """A p-value, which draws of noise cannot tell from a smaller one where none of them is as extreme."""
    return f"p {'≤' if p_value * (DRAWS + 1) < 1.5 else '='} {p_value:.2g}"


def _missing(begun: str, named: Sequence[str], spelled: int, unknown: float) -> str:
    """With so many of the names spelled out, and that something unknown is missing beside them if it is likely."""
    more = [f"{len(named) - spelled} more"] if len(named) > spelled else []
    unknowns = [f"something unknown ({unknown:.2f})"] if unknown else []
    *first, last = [*named[:spelled], *more, *unknowns]
    return f"{begun}Missing: {', '.join(first)}{', and ' if more or unknowns else ', ' if first else ''}{last}."


def _named(answer: Verdict) -> Iterator[str]:
    """Effects that are likely to be missing, and groups of which one is, with their probabilities."""
    yield from (f"{_plain(name)} ({p:.2f})" for name, p in answer.effects.items() if p > NAMED)
    yield from (f"{either(group)} ({p:.2f})" for group, p in undecided(answer))


def undecided(answer: Verdict) -> list[tuple[list[str], float]]:
    """Groups of effects that cannot be told apart, none of which is named by itself, with the probability of any."""
    groups = zip(answer.indistinguishable, answer.p_indistinguishable, strict=True)
    named = {name for name, p in answer.effects.items() if p > NAMED}
    return [(group, p) for group, p in groups if not {*group} & named]


def either(group: Sequence[str]) -> str:
    """The likeliest two of a group, and that there are more if there are."""
    return " or ".join([*map(_plain, group[:2]), *(["alike"] if len(group) > 2 else [])])


def _plain(name: str) -> str:
    return name.replace("_", " ")


def lines(answer: Verdict, context: Context) -> list[str]:
    """How large it is, what it did to the parameters, what cannot be told apart and what would tell it, what is left
    over, and whether it is proved; or, where nothing is missing, what would have shown."""
    if not answer.detected:
        said = [_limits(context.seen), *_unlike(context.predictions)]
    else:
        said = [
            _sizes(answer, context.simulator),
            _moved(answer),
            _alike(answer),
            _left(answer),
            _proof(answer, trusted=context.trusted),
        ]
    return [line for line in said if line]


def _sizes(answer: Verdict, simulator: Simulator) -> str:
    """Where they differ most, what the headline has no room for, and the sizes of what is missing: of each effect the
    main one before any other."""
    found = answer.explanations[0] if answer.explanations else None
    by_effect = [_main_first(found.of(effect)) for effect in answer.effects] if found else []
    ranks = itertools.zip_longest(*by_effect)
    sizes = [one for rank in ranks for one in rank if one is not None]
    values = [quantity(name, e) + in_the_car(name, e, simulator.nominal) for name, e in sizes]
    spelled = "; ".join(values[:IN_LINE]) + (f"; and {len(values) - IN_LINE} more" if len(values) > IN_LINE else "")
    acting = [f"{one}." for one in found.acting] if found else []
    size = [f"{spelled}."] if spelled else []
    return " ".join([_differ(answer, simulator), *_beyond_headline(answer), *size, *acting])


def _beyond_headline(answer: Verdict) -> list[str]:
    """What is named and not spelled out in the headline."""
    more = [one for one in _named(answer) if one not in answer.headline]
    return [f"Also missing: {', '.join(more)}."] if more else []


def _main_first(sizes: Mapping[str, Estimate]) -> list[tuple[str, Estimate]]:
    """The sizes of an effect, the one that is most of its standard deviations off its null first."""

    def certain(one: tuple[str, Estimate]) -> float:
        name, e = one
        return abs(e.mean - null(EFFECT_PARAMETERS[name])) / max(e.std, 1e-300)

    return sorted(sizes.items(), key=certain, reverse=True)


def _differ(answer: Verdict, simulator: Simulator) -> str:
    """That they differ, and where most."""
    most = [f"most in {one.channel} {when(one, simulator)}" for one in answer.mismatch[:1]]
    return f"They differ ({spoken_p(answer.p_value)}), {most[0]}." if most else as_a_whole(answer)


def as_a_whole(answer: Verdict) -> str:
    """That a mismatch is detected, and that it shows in no one place more than noise does anywhere."""
    return f"They differ ({spoken_p(answer.p_value)}), but no single stretch of time or signal stands out."


def when(place: Place, simulator: Simulator) -> str:
    """In which extremes of the drive, or in which stretch of time."""
    if not place.regime and throughout(simulator, place.from_s, place.to_s):
        return "throughout"
    return place.regime or spoken(place.within)


def in_the_car(name: str, e: Estimate, nominal: np.void) -> str:
    """What a size means for a constant of the vehicle file, if it is one: ` (mu 1.12, stated 3)`."""
    if name in FACTORS and (stated := nominal[FACTORS[name]]) > 0.0:
        return f" ({FACTORS[name].removesuffix('_stated')} {stated * e.mean:.3g}, stated {stated:.3g})"
    return f" (beside {ADDED[name]} {nominal[ADDED[name]]:.4g})" if name in ADDED else ""


def _moved(answer: Verdict) -> str:
    """Base parameters that move most, from the base model's to what holds whatever is missing."""
    off = list[tuple[float, str]]()
    for name, one in answer.base_parameters.items():
        before, after, unit = _moves(one)
        shift = abs(after["mean"] - before["mean"]) / max(before["std"], 1e-300)
        words = f"{name} from {_said(before)} to {_said(after)} {unit}".removesuffix(" 1")
        off += [(shift, words)] if shift > MOVED else []
    moved = [words for _, words in sorted(off, reverse=True)[:PARAMETERS]]
    return f"With what is missing averaged over, {'; '.join(moved)}." if moved else ""


def _moves(one: Any) -> tuple[Mapping[str, float], Mapping[str, float], str]:
    return one["before"], one["after"], one["unit"]


def _said(e: Mapping[str, float]) -> str:
    return mean_and_std(e["mean"], e["std"])


def _alike(answer: Verdict) -> str:
    """What cannot be told apart, and what would tell it."""
    groups = [enumerated([*map(_plain, group)]) for group in answer.indistinguishable]
    said = [f"These recordings hardly tell apart {'; '.join(groups)}."] if groups else []
    return " ".join([*said, answer.separating_experiment]).strip()


def _left(answer: Verdict) -> str:
    """What no effect stands for, as far as it shows, and parameters that would leave their priors."""
    return " ".join([*_shown(answer), *_at_bounds(answer.unknown)])


def _shown(answer: Verdict) -> Iterator[str]:
    """The load or error that no effect stands for, or that there is one which is too small to be located."""
    if answer.unknown is None or answer.unknown.over_time is None:
        yield from [TOO_SMALL] if answer.p_unknown > NAMED else []
        return
    law, over = answer.unknown.laws[0], answer.unknown.over_time
    if law.probability <= NAMED or law.size.mean < SURE * law.size.std:
        yield f"Left over: something unknown; what it acts on cannot be told, perhaps {law.target}."
        return
    follows = f", which follows {law.signal}" if law.share >= FOLLOWS else ""
    size = quantity("", law.size).removeprefix(" = ")
    most = f", most {spoken(over.within)}" if over.within else ""
    yield f"Left over: {law.target} of {size} (root mean square){follows}{most}."


def _at_bounds(unknown: Unknown | None) -> list[str]:
    found = [(name, one.prior[name], bound) for one in _outgrown(unknown) for name, bound in one.bound.items()]
    if not found:
        return []
    names = enumerated([name for name, _, _ in found])
    return [f"{names} would leave the prior: it is too narrow, or more is missing. {widen(found)}"]


def _outgrown(unknown: Unknown | None) -> Sequence[Outgrown]:
    return unknown.beyond_prior if unknown else ()


def widen(at_bounds: Sequence[tuple[str, tuple[float, float], float]]) -> str:
    """What to do about parameters that are at bounds: their names, their boxes, and where in them they are."""
    words = " ".join(f"'prior.{name}=[{low:g},{high:g}]'" for name, (low, high) in map(_longer, at_bounds))
    return (
        f"Repeat with wider priors, {words}, or state what was measured in the vehicle file. "
        "Keep a limit that is certain."
    )


def _longer(one: tuple[str, tuple[float, float], float]) -> tuple[str, tuple[float, float]]:
    """A box that reaches further at the bound that is nearer; what cannot be negative stays so."""
    name, (low, high), at = one
    more = LONGER * (high - low)
    if high - at < at - low:
        return name, (low, float(rounded(high + more, more)))
    least = max(low - more, 0.5 * low) if low >= 0.0 else low - more
    return name, (float(rounded(least, low - least)), high)


def _proof(answer: Verdict, *, trusted: bool) -> str:
    """Whether the extended model is to be preferred, why, and in which effects it is not what the headline names."""
    if "accepted" not in answer.fit:
        return ""
    verdict = "accepted" if answer.fit["accepted"] else "not accepted"
    said = f"On held-out data the extended model is {verdict}: {answer.fit['accepted_because']}."
    doubt = " It may predict well, but its parameters are uncertain until the warnings are resolved."
    return said + _its_set(answer) + (doubt if answer.fit["accepted"] and not trusted else "")


def _its_set(answer: Verdict) -> str:
    """How many sets of effects are about as likely as that of the extended model, and what this has beside the effects
    that are likely one by one, and lacks of them; nothing where it is those, and as likely as not."""
    likeliest, *others = answer.explanations
    has, named = likeliest.effects, [name for name, p in answer.effects.items() if p > NAMED]
    more, less = ([_plain(n) for n in a if n not in b] for a, b in ((has, named), (named, has)))
    unlike = [f"{word} {enumerated(names)}" for word, names in (("with", more), ("without", less)) if names]
    if likeliest.in_all > NAMED and not unlike:
        return ""
    rivals = sum(one.in_all >= RIVAL * likeliest.in_all for one in others)
    own = f" Its own has the effects above, {', '.join(unlike)}." if unlike else ""
    share, averaged = f"({100.0 * likeliest.in_all:.2g} % of draws)", "base parameters are averaged over all sets"
    if not rivals:
        return f" Its set of effects is the likeliest {share}; {averaged}.{own}"
    alike = f"{rivals} other sets of effects are" if rivals > 1 else "Another set of effects is"
    return f" {alike} about as likely as its own {share}: go by the probability of each effect; {averaged}.{own}"


def _unlike(predictions: Mapping[str, Prediction]) -> Iterator[str]:
    """That what was held out, where nothing is looked for, is not what the base model predicts."""
    covered = predictions["base"].coverage90 if "base" in predictions else 0.0
    if covered < HARDLY_COVERED:
        yield (
            f"But what was held out, where nothing is searched for, is unlike it: {covered:.0%} of it lies in the 90 % "
            "band. Hold out another recording, and it will be searched."
        )


def _limits(seen: Card) -> str:
    """How many of the effects that are not fitted would have been seen, and those seen best by their sizes."""
    shown = seen.could_show()
    if not shown:
        return "But they are too short or too gentle to show any known effect."
    known = len(shown) + len(seen.invisible()) + len(seen.cannot_act)
    best = ", ".join(f"{c.parameter.name} from {_least(c)}" for c in list(shown.values())[:EXAMPLES])
    return f"They would have shown {len(shown)} of the {known} known effects that are not fitted, among them {best}."


def _least(seen: Candidate) -> str:
    """The smallest size that is seen, and off what if that is not 0."""
    rest = null(seen.parameter)
    size = f"{seen.least} {seen.parameter.unit}".removesuffix(" 1")
    return f"{size} off {rest:g}" if rest else size
