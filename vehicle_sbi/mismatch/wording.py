"""The answer as a few sentences, for people."""

from collections.abc import Mapping, Sequence

from vehicle_sbi.inference.directions import null
from vehicle_sbi.mismatch.acceptance import Acceptance
from vehicle_sbi.mismatch.answer import Estimate, Named, Place, Unknown, Unsupported, listed, quantity
from vehicle_sbi.mismatch.explanation import Explanation
from vehicle_sbi.mismatch.locate import Stretch, lies_in, spoken
from vehicle_sbi.mismatch.separability import Candidate, Card
from vehicle_sbi.physics.effects import CATALOGUE

SPELLED_OUT = 5  # parameters of an effect at most
ALTERNATIVES = 5  # explanations that are named beside the likeliest one
HARDLY_COVERED = 0.75  # share of the 90 % band, below which what was held out is not what the model predicts
EXAMPLES = 3  # effects that are named of those that would have shown
SPOKEN_OF = 0.2  # probability from which effects, and something unknown, are spoken of


def sentence(
    explanation: Explanation,
    found: Sequence[Named],
    doubtful: Sequence[Unsupported],
    mismatch: Sequence[Place],
    together: Sequence[Sequence[str]],
    unknown: Unknown | None,
    accepted: Acceptance | None,
    seen: Card,
    covered: float,
) -> str:
    """The diagnosis in a few sentences, for people; `covered` is the share of what was held out that lies in the base
    model's 90 % band."""
    if not explanation.detected:
        said = (
            f"Nothing is missing as far as these recordings can tell (p = {explanation.p_value:.2g}): "
            f"what is left over looks like noise. {_limits(seen)}"
        )
        return said if covered >= HARDLY_COVERED else f"{said} {_unlike(covered)}"
    said = [_difference(explanation.p_value, mismatch), _answer(explanation, found, doubtful, unknown)]
    if unknown is not None and unknown.sentence:
        said.append(unknown.sentence)
    others = [effects for effects in together if effects != found[0].effects]
    if others:
        named = [listed(one) for one in others[:ALTERNATIVES]]
        more = len(others) - len(named)
        named += [f"{more} more {'set' if more == 1 else 'sets'} of effects"] if more else []
        said.append(f"These recordings cannot tell it from {', or '.join(named)}.")
        said.append(_whatever_else(explanation.single))
    if accepted is not None:
        said.append(_proof(accepted))
    return " ".join(said)


def distrusted(said: str) -> str:
    """The same of a fit that is not to be trusted."""
    return f"The base model's fit is not to be trusted; by it, {said[0].lower()}{said[1:]}"


def _proof(accepted: Acceptance) -> str:
    """Whether the extended model is to be preferred, and why."""
    verdict = "accepted" if accepted.accepted else "not accepted"
    return f"On held-out data the extended model is {verdict}: {accepted.because}."


def _difference(p_value: float, mismatch: Sequence[Place]) -> str:
    """That they differ, and where most."""
    where = [f", most of all in {one.channel} {_when(one.regime, one.within)}" for one in mismatch[:1]]
    return f"Simulation and recording differ (p = {p_value:.2g}){''.join(where)}."


def _answer(
    explanation: Explanation, found: Sequence[Named], doubtful: Sequence[Unsupported], unknown: Unknown | None
) -> str:
    """What explains it, as far as anything known does."""
    nothing = f"Still the likeliest is that nothing is missing ({explanation.p_none:.2f})"
    if not found:
        nothing_known = "No known effect explains any of it for certain."
        said = f"{nothing}." if explanation.p_none > explanation.p_unknown else nothing_known
        return " ".join([said, *(one.sentence for one in doubtful[:1])])
    best, examined = found[0], explanation.best
    named, verb = listed(best.effects), "explains" if len(best.effects) == 1 else "explain"
    share = f"{examined.share_explained:.0%}" if examined.model.effects == best.effects else ""
    likeliest = max(best.probability, explanation.p_unknown)
    if explanation.p_none > likeliest:
        said = f"{nothing}; else {named} {verb} it best, with {best.probability:.2f}"
    elif explanation.known_leads:
        said = f"{named} {verb} {f'{share} of ' if share else ''}it with probability {best.probability:.2f}"
    elif unknown is not None and not unknown.effects:
        nearest = f"of known effects {named} {verb} it best, with {best.probability:.2f}"
        said = f"Something outside the catalogue explains it with probability {explanation.p_unknown:.2f}; {nearest}"
    else:
        left, part = examined.largest_block, f"{share} at most" if share else "a part of it"
        where = _when(left.regime, lies_in(examined.model.fit.simulator, left))
        said = (
            f"No known effect explains all of it: {named} {verb} {part}, and something unknown remains in "
            f"{left.channel} {where}"
        )
    meaning = "; ".join(CATALOGUE[name].meaning for name in best.effects)
    sizes = "; ".join(size for name in best.effects for size in _sizes(name, best.sizes))
    return " ".join([f"{said}: {meaning} ({sizes}).", *(f"{acts}." for acts in best.acting)])


def _sizes(effect: str, own: Mapping[str, Estimate]) -> list[str]:
    """The sizes of an effect's parameters; of a profile its range."""
    values = {name: e for name, e in own.items() if name.split(".")[0] == effect}
    if len(values) <= SPELLED_OUT:
        return [quantity(name, e) for name, e in values.items()]
    low, high = min(e.mean for e in values.values()), max(e.mean for e in values.values())
    return [f"{effect}: {len(values)} values from {low:.2g} to {high:.2g} {next(iter(values.values())).unit}"]


def _whatever_else(single: Mapping[str, float]) -> str:
    """How probable each effect is over all sets that hold it; the likeliest one and those that are at all likely."""
    likely = [f"{name} {p:.2f}" for k, (name, p) in enumerate(single.items()) if k == 0 or p > SPOKEN_OF]
    return f"Whatever else is missing, the probability that an effect is: {', '.join(likely[:ALTERNATIVES])}."


def _unlike(covered: float) -> str:
    """That what was held out, where nothing is looked for, is not what the base model predicts."""
    return (
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


def _when(regime: str, within: Sequence[Stretch]) -> str:
    """The regime in words, or the time."""
    return (f"where {regime.replace(' above ', ' is above ')}" if " above " in regime else regime) or spoken(within)
