"""Parameters of a vehicle, and the physics that its simulation lacks, from recordings of a drive.

    from vehicle_sbi import read, identify, diagnose, simulate

What is imported here is looked up in `vehicle_sbi.api` when it is asked for, so that importing the package is quick.
"""

import importlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from vehicle_sbi.api import diagnose, identify, read, simulate

__all__ = ["diagnose", "identify", "read", "simulate"]


def __getattr__(name: str) -> object:
    if name not in __all__:
        raise AttributeError(f"module 'vehicle_sbi' has no attribute '{name}'")
    return getattr(importlib.import_module("vehicle_sbi.api"), name)
