"""What every test runs under: one thread, pictures without a screen, and the shapes in signatures checked."""

import os
import re

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ["MPLBACKEND"] = "Agg"

from collections.abc import Callable
from pathlib import Path
from typing import get_args

import hypothesis
import torch
from beartype import beartype
from beartype.roar import BeartypeDecorHintException
from jaxtyping import AbstractArray, install_import_hook

ROOT = Path(__file__).resolve().parent.parent


def plain_modules() -> list[str]:
    """The modules without compiled code: numba cannot compile a function that a type checker has wrapped."""
    files = [file for file in (ROOT / "vehicle_sbi").rglob("*.py") if file.name != "__init__.py"]
    plain = [
        file
        for file in files
        if not re.search(r"^(import|from) (numba|vehicle_sbi.compiled)\b", file.read_text(), re.MULTILINE)
    ]
    return [".".join(file.relative_to(ROOT).with_suffix("").parts) for file in plain]


def has_shape(hint: object) -> bool:
    own = isinstance(hint, type) and issubclass(hint, AbstractArray)
    return own or any(has_shape(part) for part in get_args(hint))


def checked(function: Callable[..., object]) -> Callable[..., object]:
    """`function`, its types checked at every call if it states a shape; other wrong types are its own to refuse."""
    if not any(has_shape(hint) for hint in function.__annotations__.values()):
        return function
    try:
        return beartype(function)
    except BeartypeDecorHintException:  # Self, or a plain Protocol, cannot be checked
        return function


install_import_hook(plain_modules(), f"{__name__}.checked")

torch.set_num_threads(1)

from vehicle_sbi.threads import use_cores  # noqa: E402 - once the hook is there that checks shapes

use_cores(1)  # tests run side by side, one on each core

# Compilation makes first examples slow, and a test that fails once in a while tells nobody anything.
hypothesis.settings.register_profile("house", deadline=None, derandomize=True)
hypothesis.settings.load_profile("house")
