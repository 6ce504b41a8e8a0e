"""What is written of a case: the files that the tool gets, and apart from them the truth, sealed."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import yaml

from concealed.strength import WARMUP_S, WINDOW_S, Given
from vehicle_sbi.data.channels import CHANNELS
from vehicle_sbi.files import write_atomically, write_text


def overrides(case: Path, given: Given, recordings: Sequence[str], heldout: Sequence[str]) -> list[str]:
    """The words that `scripts/diagnose.py` is called with: the one place that knows its grammar."""
    prior = {name: f"[{low:.6g},{high:.6g}]" for name, (low, high) in given.prior.items()}
    prior.setdefault("steering_ratio.gain", "null")  # in the default prior; null takes it out
    return [
        f"recordings=[{','.join(str(case / name) for name in recordings)}]",
        f"heldout=[{','.join(str(case / name) for name in heldout)}]",
        f"vehicle={case / 'vehicle.yaml'}",
        f"effect_prior={given.effect_prior}",
        f"model={given.model}",
        f"window_s={WINDOW_S:g}",
        f"warmup_s={WARMUP_S:g}",
        f"recording.drive={given.drive}",
        f"recording.v_min={given.v_min:g}",
        f"recording.channels=[{','.join(given.channels)}]",
        *(f"++prior.{name}={value}" for name, value in prior.items()),
    ]


def write_case(
    case: Path, given: Given, recordings: Mapping[str, Mapping[str, np.ndarray]], heldout: Sequence[str]
) -> None:
    """The files that the tool gets: recordings, car, and how it is called; `case.yaml` comes last."""
    for name, columns in recordings.items():
        table = pd.DataFrame({CHANNELS[c].column if c != "time" else "time_s": v for c, v in columns.items()})
        text = table.to_csv(index=False, float_format="%.9g")
        write_text(case / name, text)
    known = {k: v for k, v in asdict(given.vehicle).items() if v is not None}
    write_text(case / "vehicle.yaml", yaml.safe_dump(known, sort_keys=False))
    train = [name for name in recordings if name not in heldout]
    content = {
        "overrides": overrides(case.resolve(), given, train, heldout),
        "recordings": train,
        "heldout": list(heldout),
        "model": given.model,
        "drive": given.drive,
        "channels": list(given.channels),
        "prior": {name: list(box) for name, box in given.prior.items()},
        "v_min": given.v_min,
    }
    write_text(case / "case.yaml", yaml.safe_dump(content, sort_keys=False, width=1000))


def write_sealed(sealed: Path, index: int, truth: Mapping[str, Any], series: Mapping[str, np.ndarray]) -> None:
    arrays: dict[str, Any] = dict(series)
    write_atomically(sealed / f"{index:04d}.npz", lambda file: np.savez_compressed(file, **arrays))
    write_text(sealed / f"{index:04d}.json", json.dumps(truth, indent=1, allow_nan=False))
