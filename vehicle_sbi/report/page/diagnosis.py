"""The page of a diagnosis: what is missing, the picture that shows it, how probable, what it did to the parameters."""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from vehicle_sbi.mismatch.answer.schema import Verdict, listed
from vehicle_sbi.mismatch.answer.verdict import Found
from vehicle_sbi.mismatch.answer.wording import (
    NAMED,
    TOO_SMALL,
    as_a_whole,
    either,
    in_the_car,
    spoken_p,
    undecided,
    when,
)
from vehicle_sbi.mismatch.estimation.estimate import Estimate, quantity
from vehicle_sbi.mismatch.estimation.fit import Fit
from vehicle_sbi.mismatch.hypotheses.block import throughout
from vehicle_sbi.mismatch.problem.case import Case
from vehicle_sbi.parameters import Parameter
from vehicle_sbi.physics.effects import CATALOGUE
from vehicle_sbi.report.card import LEGEND, could_show, hidden
from vehicle_sbi.report.mismatch_figures import LEAST, MOST_BARS, smooth
from vehicle_sbi.report.page.charts import Series, chart
from vehicle_sbi.report.page.page import Page
from vehicle_sbi.report.page.parts import (
    Bar,
    Bars,
    Curves,
    Interval,
    Listed,
    Part,
    Range,
    Ranges,
    Section,
    Table,
    Words,
    raised,
    unit,
)
from vehicle_sbi.report.page.series import series
from vehicle_sbi.report.tables.base_parameters import NOT_TOLD, base_for_people
from vehicle_sbi.report.tables.symbols import minus
from vehicle_sbi.rounding import mean_and_std

SETS = 8  # of effects that are listed
LABELS = {"recorded": "recorded", "base": "base model", "extended": "extended model", "place": "more than noise"}
ARM = "of the centre of gravity, or of where the vehicle file puts the IMU"
CLAUSES = {  # what the name of a size leaves open
    "imu_lever_arm.x": f"ahead {ARM}",
    "imu_lever_arm.y": f"left {ARM}",
    "imu_lever_arm.z": f"above {ARM.removeprefix('of ')}",
    "lateral_load_transfer.uneven": "square of the share of an axle's load that moves to its outer wheel, per m/s^2",
    "lateral_load_transfer.period": "with which the body leans, and load moves",
    "lateral_load_transfer.damping": "ratio with which the body leans, and load moves",
    "load_sensitivity.sprung": "share of what braking moves between the axles that comes as the body pitches",
    "load_sensitivity.period": "with which the body pitches, and load moves",
    "load_sensitivity.damping": "ratio with which the body pitches, and load moves",
    "payload.x": "ahead of the empty car's centre of gravity",
}
GROUPS = {group: f"sensors of the mapping's group {group}" for group in ("can", "wheel_speed")}
BAND = {"band": "its 90 % band"}
PARAMETERS = {"base": "base model alone", "extended": "averaged over what may be missing"}
OF_CURVES = (
    "Where only the extended model meets the recorded signal, something was missing. Gaps: held out, beside it, "
    "or left out of the recording (notes)."
)
OF_BASE_ALONE = "Recorded signals over those of the base model, to which nothing had to be added."
OF_BARS = (
    "How probable it is that each effect is missing. Right of the dashed line it is named. Sizes: mean ± one standard "
    "deviation."
)
OF_RANGES = "Each base parameter within its prior's box, with 90 % intervals. Those that move had hidden it."
OF_REST = "Recorded less simulated, smoothed over a quarter of a second. A good model leaves a line about zero."
OF_HELD_OUT = "Both models predict what they were not fitted to, which says whether the extension is worth it."
OF_SCORES = (
    "Log score in nats a sample, higher is better. NRMSE: root-mean-square error over the signal's standard deviation. "
    "CRPS (continuous ranked probability score) in each channel's unit. Both are better when lower."
)
OF_PLACES = (
    "p: how often noise alone would score as high in any place; that of the first line is of all tests together. "
    "Share: of the score of all rows."
)
OF_EFFECTS = (
    "Probability that an effect is missing, before the recordings and after, whatever else is missing. Sizes are mean "
    "± one standard deviation, where it is missing. Any number of effects may be missing at once, beside "
    "discrepancies that no effect explains."
)
OF_SETS = (
    "Probability that exactly these effects are missing: nothing else, or nothing but a discrepancy that no effect "
    "explains. The first set is the extended model."
)
OF_LAWS = (
    "Loads and errors that no effect explains: root mean square, and the signal of the drive that they follow best, "
    "with the share of their course that it explains."
)


def page_of(case: Case, found: Found, answer: Verdict) -> Page:
    """Headline, lines and pictures; the tables folded away."""
    return Page(
        title=f"Diagnosis of {case.name}",
        headline=answer.headline,
        lines=answer.lines,
        warnings=answer.warnings,
        shown=[
            _recorded_and_simulated(found, answer),
            Section(heading="What is missing", said=OF_BARS, parts=[Bars(_bars(answer))]),
            Section(heading="What it did to the parameters", said=OF_RANGES, parts=[_moved(found, answer)]),
        ],
        folded=[
            _left_over(found, answer),
            *_held_out(case, found, answer),
            Section(heading="All effects", parts=[Table(_effects(answer, found), OF_EFFECTS)]),
            Section(heading="Effects together", parts=[Table(_sets(answer), OF_SETS)]),
            Section(heading="What no effect explains", parts=[_unknown(answer)]),
            Section(heading="Where they differ", parts=[_where(answer, found)]),
            Section(heading="Base parameters", parts=[Table(base_for_people(answer.base_parameters))]),
            Section(
                heading="What these recordings could have shown",
                parts=[Table(could_show(found.seen, beside=answer.effects), LEGEND), Words(hidden(found.seen))],
            ),
            *_notes(answer),
        ],
    )


def _fits(found: Found) -> dict[str, Fit]:
    """The base model, and the extended one if it is another."""
    model = found.extended.model
    return {"base": found.examined.fit} | ({"extended": model.fit} if model.effects else {})


def _drawn(of: Series, names: Mapping[str, str], label: str) -> Curves:
    figure, every = chart(of, names)
    keys = {name: said for name, said in names.items() if name in of.curves}
    keys |= {"place": LABELS["place"]} if any(of.places.values()) else {}
    keys |= BAND if of.band is not None else {}
    return Curves(figure, keys, label, every, together=len(of.starts) > 1)


def _recorded_and_simulated(found: Found, answer: Verdict) -> Section:
    """Both models with the initial states that suit the recording best, as they are in its fit."""
    fits = _fits(found)
    windows, observed = fits["base"].simulator.windows, fits["base"].observation.observed
    curves = {"recorded": observed} | {name: observed - fit.unexplained for name, fit in fits.items()}
    drawn = _drawn(
        series(windows, curves, places=_places(found, answer)), LABELS, f"Recorded and simulated: {answer.headline}"
    )
    said = OF_CURVES if "extended" in fits else OF_BASE_ALONE
    return Section(heading="Recorded and simulated", said=said, parts=[drawn])


def _left_over(found: Found, answer: Verdict) -> Section:
    fits = _fits(found)
    windows = fits["base"].simulator.windows
    rest = {name: smooth(fit.unexplained, windows) for name, fit in fits.items()}
    drawn = _drawn(series(windows, rest, places=_places(found, answer)), LABELS, "Recorded less simulated")
    return Section(heading="What the models leave over", said=OF_REST, parts=[drawn])


def _places(found: Found, answer: Verdict) -> dict[str, list[tuple[float, float]]]:
    """Stretches of time in which the base model misses, by channel, where that is not all of it."""
    simulator = found.examined.fit.simulator
    alone, places = simulator.windows.alone, dict[str, list[tuple[float, float]]]()
    for place in answer.mismatch:
        if not place.regime and not throughout(simulator, place.from_s, place.to_s):
            within = place.within if alone else [place]
            places.setdefault(place.channel, []).extend((one.from_s, one.to_s) for one in within)
    return places


def _held_out(case: Case, found: Found, answer: Verdict) -> list[Section]:
    """What was held out as both models predict it, where they can be simulated there."""
    if not found.predictions or not case.held_out.anything:
        return []
    windows, observed = case.held_out.simulator.windows, case.held_out.observed
    last = [*found.predictions.values()][-1]
    curves = {"recorded": observed} | {name: one.y for name, one in found.predictions.items()}
    band = (last.y - last.half_width, last.y + last.half_width)
    drawn = _drawn(series(windows, curves, band=band), LABELS, "Held-out recordings and predictions")
    said = Words([_accepted(answer)] if "accepted" in answer.fit else [])
    return [
        Section(heading="Held-out recordings", said=OF_HELD_OUT, parts=[said, drawn, Table(_scores(answer), OF_SCORES)])
    ]


def _accepted(answer: Verdict) -> str:
    said = "accepted" if answer.fit["accepted"] else "not accepted"
    return f"The extended model is {said}: {answer.fit['accepted_because']}."


def _sizes(answer: Verdict) -> dict[str, Estimate]:
    """Sizes of effects, each from the likeliest set that has it."""
    sizes = {name: e for one in reversed(answer.explanations) for name, e in one.sizes.items()}
    return sizes | {name: e for one in answer.unsupported for name, e in one.parameters.items() if name not in sizes}


def _bars(answer: Verdict) -> list[Bar]:
    """A bar for each effect that is at all likely and groups of which one is, one for what no effect stands for, and
    one for nothing."""
    sizes, laws = _sizes(answer), answer.unknown.laws[:1] if answer.unknown else []

    def said(effect: str) -> str:
        own = [(name, e) for name, e in sizes.items() if name.split(".")[0] == effect]
        return raised(minus("; ".join(_explained(name, e) for name, e in own)))

    likely = [(name, p) for name, p in answer.effects.items() if p >= LEAST][:MOST_BARS]
    bars = [Bar(name.replace("_", " "), p, said(name)) for name, p in likely]
    bars += [Bar(either(group), p, "any of them; these recordings hardly tell which") for group, p in undecided(answer)]
    bars.sort(key=lambda bar: -bar.share)
    left = "".join(raised(minus(f"{law.target}{quantity('', law.size)}")) for law in laws)
    return [*bars, Bar("something unknown", answer.p_unknown, left), Bar("nothing at all", answer.p_none)]


def _explained(name: str, e: Estimate) -> str:
    """A size by its own name, with what that leaves open."""
    own = name.partition(".")[2]
    clause = CLAUSES.get(name) or GROUPS.get(own)
    return quantity(own.replace("_", " "), e) + (f" ({clause})" if clause else "")


def _moved(found: Found, answer: Verdict) -> Ranges:
    boxes = found.examined.fit.simulator.space.parameters
    rows = [_range(p, answer.base_parameters[p.name]) for p in boxes if p.name in answer.base_parameters]
    return Ranges(rows, PARAMETERS | {"prior": "prior"})


def _range(p: Parameter, values: Any) -> Range:
    return Range(
        name=p.name,
        unit=unit(p),
        low=p.low,
        high=p.high,
        intervals=[
            Interval(model, e["q05"], e["mean"], e["q95"], minus(mean_and_std(e["mean"], e["std"])))
            for model, e in (("base", values["before"]), ("extended", values["after"]))
        ],
        remark="" if values["identified"] else NOT_TOLD,
    )


def _effects(answer: Verdict, found: Found) -> pd.DataFrame:
    sizes, nominal = _sizes(answer), found.base.fit.simulator.nominal
    prior = found.pruned.expansion.probabilities if found.pruned else {}
    rows = [
        {
            "effect": name,
            "what it is": CATALOGUE[name].meaning,
            "prior": f"{prior[name]:.2f}" if name in prior else "",
            "probability": f"{p:.2f}",
            "size": "; ".join(
                quantity(key, e) + in_the_car(key, e, nominal) for key, e in sizes.items() if key.split(".")[0] == name
            ),
        }
        for name, p in answer.effects.items()
    ]
    return pd.DataFrame(rows, columns=["effect", "what it is", "prior", "probability", "size"])


def _sets(answer: Verdict) -> pd.DataFrame:
    """The likeliest sets, whether anything is left over beside them or not, and none."""
    likeliest = answer.explanations[:SETS]
    rows = [{"probability": f"{one.in_all:.3f}", "effects": listed(one.effects)} for one in likeliest]
    rows.append({"probability": f"{answer.p_none:.3f}", "effects": "none"})
    return pd.DataFrame(rows)


def _unknown(answer: Verdict) -> Part:
    """Loads and errors beside the effects, if there are any."""
    laws = answer.unknown.laws if answer.unknown else []
    if not laws:
        return Words([TOO_SMALL if answer.p_unknown > NAMED else "Nothing beyond noise."])
    frame = pd.DataFrame(
        {
            "what": [law.target for law in laws],
            "root mean square": [quantity("", law.size).removeprefix(" = ") for law in laws],
            "follows": [f"{law.signal} ({law.share:.0%})" for law in laws],
        }
    )
    return Table(frame, OF_LAWS)


def _where(answer: Verdict, found: Found) -> Part:
    if not answer.mismatch:
        return Words([as_a_whole(answer) if answer.detected else "Nowhere beyond noise."])
    frame = pd.DataFrame(
        {
            "channel": [p.channel for p in answer.mismatch],
            "p": [spoken_p(p.p_value).removeprefix("p ").removeprefix("= ") for p in answer.mismatch],
            "share": [f"{p.share_of_misfit:.0%}" for p in answer.mismatch],
            "where": [when(p, found.base.fit.simulator) for p in answer.mismatch],
        }
    )
    return Table(frame, OF_PLACES)


def _scores(answer: Verdict) -> pd.DataFrame:
    """A row for each measure, a column for each model."""
    columns = dict[str, dict[str, str]]()
    for name in ("base", "extended"):
        score: Any = answer.fit.get(name)
        if score is not None:
            columns[LABELS[name]] = {
                "log score": f"{score['log_score']:.3f}",
                "in 90 % band": f"{score['coverage90']:.0%}",
                **{f"NRMSE {channel}": f"{value:.3f}" for channel, value in score["nrmse"].items()},
                **{f"CRPS {channel}": f"{value:.3g}" for channel, value in score["crps"].items()},
            }
    return pd.DataFrame(columns).rename_axis("measure").reset_index()


def _notes(answer: Verdict) -> list[Section]:
    notes = [note for note in answer.notes if note not in answer.warnings]
    return [Section(heading="Notes", parts=[Listed(notes)])] if notes else []
