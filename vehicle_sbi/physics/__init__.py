"""What a vehicle does: plain scalar Python compiled by numba."""
