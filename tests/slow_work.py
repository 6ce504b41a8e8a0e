"""Work that takes a while, for workers that are to be killed meanwhile; they import nothing else."""

import time


def slowly_squared(x: int) -> int:
    time.sleep(0.5)
    return x * x
