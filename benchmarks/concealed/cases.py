"""Cases: what is concealed in which drive, how strongly, and the files that the tool gets; a function of (seed, index).

Attempts go on until one of them lets the effect reach the signal-to-noise ratio that was drawn, or the best of them is
taken.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from concealed import outside
from concealed.case_files import write_case, write_sealed
from concealed.concealment import CLOSE, SHORT, Built, Concealment, draft, draft_outside
from concealed.mix import SNRS, Slot, slot
from concealed.setups import attempt, happens_once, recording
from vehicle_sbi.physics.effects import CATALOGUE

DETECTABLE = 4.0
NOTHING = {"L0": 1.5, "L1": 2.0}  # what the truth without effects may differ from the fitted base model, projected
ATTEMPTS, MOST_ATTEMPTS = 8, 40  # that may fall short, and of any kind


def conceal(seed: int, wanted: Slot) -> Built:
    """The first attempt in which what is wanted reaches the ratio that was drawn, or the one that comes closest.

    An attempt that falls short is only remembered; if all do, the best of them is taken at a ratio that it reaches.
    """
    short: list[tuple[float, int]] = []
    for k in range(MOST_ATTEMPTS):
        if len(short) >= ATTEMPTS and max(short)[0] > 0.0:
            break
        built, worth = _attempted(seed, wanted, k, wanted.snr)
        if built is not None and worth >= 1.0:
            return built
        short.append((worth, -k))
    for worth, k in sorted(short, reverse=True):
        within = [value for value in SNRS[::-1] if value < wanted.snr and value <= worth * wanted.snr]
        for target in within or [wanted.snr]:
            built, _ = _attempted(seed, wanted, -k, target, anyway=True)
            if built is not None:
                return built
    raise RuntimeError(f"case {wanted.index}: no attempt lets {wanted} be driven")


def _attempted(seed: int, wanted: Slot, k: int, target: float, *, anyway: bool = False) -> tuple[Built | None, float]:
    """Attempt k; worth nothing where the car spins out on the way, and so has no derivatives."""
    try:
        return _conceal(seed, wanted, k, target, anyway=anyway)
    except np.linalg.LinAlgError:
        return None, 0.0


def _conceal(seed: int, wanted: Slot, k: int, target: float, *, anyway: bool = False) -> tuple[Built | None, float]:
    """Attempt k: what it built, None where it falls short (unless `anyway`), and its worth, 1 where it does not."""
    rng = np.random.default_rng((seed, 10, wanted.index, k))
    hidden = Concealment(attempt(rng, wanted.level, wanted.effects), NOTHING[wanted.level])
    if not hidden.ok:
        return None, 0.0
    seconds = min(float(plan.t[-1]) for plan in hidden.setup.train)
    drafts, strengths, worth = [], [], 1.0
    for name in wanted.effects:
        inside = name in CATALOGUE
        one = draft(rng, name, hidden.quiet, hidden.theta, seconds) if inside else draft_outside(rng, name, seconds)
        if one is None:
            return None, 0.0
        strength, reached = hidden.strength(one, target)
        worth = min(worth, reached / target / (1.0 - CLOSE))
        if worth < 1.0 and not anyway:
            return None, worth
        drafts.append(one)
        strengths.append(strength)
    built = hidden.finish(drafts, strengths)
    if built is None:
        return None, 0.0
    return built, min([worth, *(beyond / DETECTABLE / (1.0 - SHORT) for beyond in built.beyond)])


def build(
    seed: int, index: int, mix: str, folder: Path, injected: Callable[..., None], injectable: Sequence[str]
) -> None:
    """Build case `index` of a mix under folder/cases, its truth under folder/sealed; nothing to do where it stands."""
    case, sealed = folder / "cases" / f"{index:04d}", folder / "sealed"
    if (case / "case.yaml").exists() and (sealed / f"{index:04d}.json").exists():
        return
    wanted = slot(seed, index, injectable, mix)
    if wanted.level == "L2":
        injected(seed, wanted, case, sealed)
        return
    built = conceal(seed, wanted)
    setup, rng = built.setup, np.random.default_rng((seed, 11, index))
    once = {name for name in built.effects if happens_once(name)}
    files, oracle = {}, {}
    names = [f"{'abcde'[i]}.csv" for i in range(len(setup.train))]
    held = [f"heldout_{i}.csv" for i in range(len(setup.heldout))]
    for name, plan in zip([*names, *held], [*setup.train, *setup.heldout], strict=True):
        lasting = {k: v for k, v in built.effects.items() if name in names or k not in once}
        series = outside.drive(setup.world, plan, lasting)
        for _ in range(6):
            if series is not None:
                break
            plan = plan.scaled(0.75)  # a held-out drive that the car cannot take
            series = outside.drive(setup.world, plan, lasting)
        if series is None:
            raise RuntimeError(f"case {index}: {name} cannot be driven")
        added = {n: setup.noise.draw(n, len(plan.t), rng) for n in setup.noise.std}
        files[name] = {"time": plan.t} | dict(recording(name, plan, series, setup.given, added).channels)
        oracle |= {f"{name}:{channel}": series[channel] for channel in setup.given.channels}
    write_sealed(sealed, index, _truth(wanted, built, once, held), oracle)
    write_case(case, setup.given, files, held)


def _truth(wanted: Slot, built: Built, once: set[str], held: Sequence[str]) -> dict[str, Any]:
    setup = built.setup
    lengths = {"abcde"[i]: float(plan.t[-1]) for i, plan in enumerate(setup.train)}
    weakest = min(built.reached, default=0.0)
    return {
        "index": wanted.index,
        "level": wanted.level,
        "kind": wanted.kind,
        "world": setup.world_name,
        "regime": setup.regime,
        "manoeuvres": [p.manoeuvre for p in (*setup.train, *setup.heldout)],
        "effects": {
            one.name: {
                "parameters": built.effects[one.name],
                "active": sorted(one.scaled) + sorted(one.shape),
                "inside": one.name in CATALOGUE,
                "snr": reached,
                "snr_beyond": beyond,
                "spans": {name: span for name, seconds in lengths.items() if (span := one.span(seconds))},
                "once": one.name in once,
            }
            for one, reached, beyond in zip(built.drafts, built.reached, built.beyond, strict=True)
        },
        "snr_drawn": wanted.snr,
        "snr": built.total,
        "detectable": bool(not built.effects or weakest >= (1 - SHORT) * DETECTABLE),
        "snr_of_nothing": built.nothing,
        "noise": asdict(setup.noise),
        "base_parameters": dict(zip(built.simulator.space.names, map(float, setup.theta), strict=True)),
        "base_fit": dict(zip(built.simulator.space.names, map(float, built.theta), strict=True)),
        "heldout": list(held),
        "heldout_comparable": not once,
        "vehicle": {k: v for k, v in asdict(setup.truth).items() if v is not None and v != math.inf},
    }
