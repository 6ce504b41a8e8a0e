"""How physics is compiled: once, kept on disk, with IEEE 754 division.

A division by zero is infinite or not a number, which a simulation counts as such. An exception that any function could
raise would keep numba from dropping the reference counts of arrays, a third of a simulation's time.
"""

from numba import njit

compiled = njit(cache=True, error_model="numpy", forceinline=True)
specialised = njit(error_model="numpy", forceinline=True)  # for one model, by its module; its caller is what is kept
