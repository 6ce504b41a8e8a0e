"""How physics is compiled: once, kept on disk, with IEEE 754 division, formulas in place where they are used.

A division by zero is infinite or not a number, which a simulation counts as such. A call that may raise, and any that
stays a call might, keeps numba from dropping the atomic reference counts of arrays, which took a third of a
simulation's time; so equations of motion are one piece of code, and what runs once a sample or less is a call.
"""

from numba import njit

compiled = njit(cache=True, error_model="numpy", forceinline=True)
compiled_apart = njit(cache=True, error_model="numpy")
