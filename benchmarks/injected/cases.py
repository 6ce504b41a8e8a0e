"""Pairs of cases from real recordings: a stretch as it was recorded, and the same with an effect put into its channels.

What the car itself has that the model lacks is not known. So each stretch is diagnosed twice, and what is scored is the
difference that the injected effect makes to the answer.
"""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from concealed.case_files import write_case
from concealed.concealment import CLOSE, settle
from concealed.injected import INJECTED, SOURCES, Source, Stretch, available, inject, stretch
from whole_car.cases import alike_to

from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.data.recording import Recording
from vehicle_sbi.errors import InputError
from vehicle_sbi.files import write_text

SNRS = (8.0, 16.0, 32.0)  # of what is injected, beyond what the base model's parameters take over
STREAM, ATTEMPTS = 40, 12
DART = "dart_jetracer"
ALL_SOURCES: Mapping[str, Source] = {**SOURCES} | {
    name: Source(
        configuration="dart_sine_steering", vehicle="dart", train_s=train_s, heldout_s=heldout_s,
        channels=("a_y", "yaw_rate"), v_min=0.3, l_f_off=0.02, file=f"{DART}/{file}",
    )
    for name, file, train_s, heldout_s in (
        ("dart_step_steering", "30_step_steering_data/car_1_Datarecording_01_22_2024_12_15_11.csv", 15.0, 10.0),
        ("dart_sine_steering", "40_sinusoidal_steering_data/car_1_Datarecording_01_22_2024_11_44_35.csv", 20.0, 12.0),
        ("dart_free_driving", "free_driving/car_1_Datarecording_09_16_2024_17_17_59.csv", 30.0, 20.0),
    )
}  # fmt: skip
HALVES = ("without", "with")  # folders of a case


def build(seed: int, index: int, folder: Path) -> None:
    """Case `index` under folder/cases, its truth under folder/sealed; nothing to do where it stands."""
    case, sealed = folder / "cases" / f"{index:04d}", folder / "sealed" / f"{index:04d}.json"
    if all((case / half / "case.yaml").exists() for half in HALVES) and sealed.exists():
        return
    effect, source, one, strength, reached = _drawn(seed, index)
    parameters = one.parameters(effect, strength)
    change = one.change(strength)
    if change is None:
        raise InputError(f"case {index}: what is injected cannot be simulated")
    write_text(sealed, json.dumps({
        "index": index,
        "source": source,
        "effect": effect,
        "parameters": parameters,
        "snr": reached,
        "alike": alike_to(one.projection, one.projection.left(change[None]))[0],
    }, indent=1))  # fmt: skip
    for half in HALVES:
        files = {}
        for name, recording in (("a.csv", one.train), ("heldout_0.csv", one.heldout)):
            acting = inject(recording, effect, parameters) if half == "with" else recording
            files[name] = _columns(acting)
        write_case(case / half, one.given, files, ["heldout_0.csv"])


def _columns(recording: Recording) -> dict[str, np.ndarray]:
    return {"time": recording.t} | {name: x for name, x in recording.channels.items() if name in CHANNELS}


def _drawn(seed: int, index: int) -> tuple[str, str, Stretch, float, float]:
    """An effect, a stretch of a recording, how strong the effect is made, and how strongly it shows: the first that is
    drawn and shows as strongly as is asked for, or the one that comes nearest.

    Raises InputError where no recording is here or none can be used.
    """
    here = available(ALL_SOURCES)
    if not here:
        raise InputError("mix=injected needs the real recordings; VEHICLE_SBI_RECORDINGS names their folder")
    found: list[tuple[str, str, Stretch, float, float]] = []
    for attempt in range(ATTEMPTS):
        rng = np.random.default_rng((seed, STREAM, index, attempt))
        effect, source, wanted = str(rng.choice(list(INJECTED))), str(rng.choice(here)), float(rng.choice(SNRS))
        try:
            one = stretch(rng, effect, source, ALL_SOURCES[source])
        except InputError:
            continue  # the stretch has no usable window
        strength, reached = settle(one.measure, wanted)
        found.append((effect, source, one, strength, reached))
        if reached >= (1.0 - CLOSE) * wanted:
            return found[-1]
    if not found:
        raise InputError(f"case {index}: no stretch of a real recording can be used")
    return max(found, key=lambda drawn: drawn[-1])
