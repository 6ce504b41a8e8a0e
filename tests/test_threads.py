"""The same work for several things on threads: same results and errors as one after another, on as many as allowed."""

import os
import subprocess
import sys
import threading
from collections.abc import Iterator

import pytest

from vehicle_sbi import threads
from vehicle_sbi.errors import InputError
from vehicle_sbi.threads import AVAILABLE, cores, each, use_cores


@pytest.fixture
def as_before() -> Iterator[None]:
    """Tests change how many cores are used; afterwards it is as before."""
    before = cores()
    yield
    use_cores(before)


@pytest.mark.parametrize("used", [1, 3])
def test_results_stand_in_the_order_of_things(used: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_used", used)
    gates = [threading.Event() for _ in range(3)]
    gates[2].set()

    def last_first(k: int) -> int:
        if used == 3:  # each ends after the one behind it
            gates[k].wait(10.0)
            gates[k - 1].set()
        return k * k

    assert each(last_first, range(3)) == [0, 1, 4]


def test_no_more_work_at_once_than_there_are_cores(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_used", 2)
    both = threading.Barrier(2, timeout=10.0)  # passed only by two at once
    names = set(each(lambda _: (both.wait(), threading.current_thread().name)[1], range(8)))
    assert len(names) == 2


def test_one_core_works_where_it_is_called(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_used", 1)
    assert each(lambda _: threading.current_thread(), range(3)) == [threading.current_thread()] * 3
    monkeypatch.setattr(threads, "_used", 8)
    assert each(lambda _: threading.current_thread(), [0]) == [threading.current_thread()]
    assert each(lambda _: 1 / 0, []) == []


@pytest.mark.parametrize("used", [1, 2])
def test_what_one_raises_is_raised(used: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_used", used)
    with pytest.raises(InputError, match="the second"):
        each(lambda k: _fail("the second") if k == 1 else k, range(4))


def _fail(said: str) -> int:
    raise InputError(said)


@pytest.mark.usefixtures("as_before")
def test_work_within_work_sees_the_cores_that_were_asked_for() -> None:
    use_cores(1)
    assert cores() == 1
    use_cores(None)
    assert cores() == AVAILABLE
    assert each(lambda _: cores(), range(4)) == [AVAILABLE] * 4


@pytest.mark.parametrize("wanted", [0, -1, 10_000, 1.5])
def test_cores_that_are_not_there_are_refused(wanted: int) -> None:
    before = cores()
    with pytest.raises(InputError, match=r"engine\.cores = .*; this machine has 1 to "):
        use_cores(wanted)
    assert cores() == before


def test_linear_algebra_and_torch_have_one_thread_within_and_as_many_as_before_afterwards() -> None:
    # In a process of its own, whose environment says nothing of threads.
    code = """
import torch
from threadpoolctl import threadpool_info
from vehicle_sbi.threads import algebra_on_one_thread

def counts():
    return [torch.get_num_threads(), *(pool["num_threads"] for pool in threadpool_info())]

torch.set_num_threads(2)
before = counts()
with algebra_on_one_thread():
    within = counts()
print(max(within), counts() == before, max(before))
"""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_NUM_THREADS")}
    ran = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    assert ran.stdout.split()[:2] == ["1", "True"]
    assert int(ran.stdout.split()[2]) >= 2


def test_an_interruption_does_not_wait_for_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(threads, "_used", 2)
    begun, ends, done = threading.Event(), threading.Event(), list[bool]()

    def work(first: bool) -> None:
        if first:
            begun.wait(10.0)
            raise KeyboardInterrupt
        begun.set()
        ends.wait(2.0)
        done.append(first)

    with pytest.raises(KeyboardInterrupt):
        each(work, [True, False])
    assert done == []
    ends.set()
