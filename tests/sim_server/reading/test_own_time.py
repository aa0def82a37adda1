"""The reader's own time: what others do with the cores does not count, rest and stops do."""

import os

from tests.sim_server.fakes import WallTime
from zensim.sim_server.reading.own_time import ReaderTime, waited_ns

PROCESS, NEXT = 1, 2
MS = 1_000_000


class Kernel:
    """Says how long processes have waited."""

    def __init__(self) -> None:
        self.waits: dict[int, int] = {PROCESS: 0, NEXT: 0}

    def waited(self, process_id: int) -> int:
        return self.waits[process_id]


def a_clock() -> tuple[WallTime, Kernel, ReaderTime]:
    wall, kernel = WallTime(), Kernel()
    time = ReaderTime(wall.now_ns, kernel.waited)
    time.watch(PROCESS)
    return wall, kernel, time


def looked_for(wall: WallTime, time: ReaderTime, milliseconds: int) -> int:
    """Look every 20 ms, and say how far the clock went."""
    before_ns = time.now_ns
    for _ in range(milliseconds // 20):
        wall.ns += 20 * MS
        time.look()
    return (time.now_ns - before_ns) // MS


def test_time_goes_on_with_the_wall_when_nothing_is_in_the_way() -> None:
    wall, _, time = a_clock()

    assert looked_for(wall, time, 1000) == 1000


def test_time_stands_while_others_have_the_cores() -> None:
    wall, kernel, time = a_clock()
    gone = 0
    for _ in range(50):
        kernel.waits[PROCESS] += 15 * MS
        gone += looked_for(wall, time, 20)

    assert gone == 250


def test_time_catches_up_when_a_long_wait_is_told_at_its_end() -> None:
    wall, kernel, time = a_clock()
    first = looked_for(wall, time, 300)
    kernel.waits[PROCESS] += 300 * MS

    second = looked_for(wall, time, 500)

    assert (first, second) == (300, 200)


def test_time_goes_on_a_little_on_any_machine() -> None:
    wall, kernel, time = a_clock()
    for _ in range(60):
        kernel.waits[PROCESS] += 20 * MS
        looked_for(wall, time, 20)

    assert time.now_ns == 200 * MS


def test_time_leaves_out_how_long_nobody_looked() -> None:
    wall, _, time = a_clock()
    wall.ns += 60_000 * MS
    time.look()

    assert time.now_ns == 1000 * MS


def test_time_does_not_jump_when_the_process_is_another() -> None:
    wall, kernel, time = a_clock()
    kernel.waits = {PROCESS: 0, NEXT: 900 * MS}
    looked_for(wall, time, 100)
    time.watch(NEXT)

    assert looked_for(wall, time, 100) == 100


def test_waits_of_this_process_are_told_and_those_of_none_are_zero() -> None:
    assert waited_ns(os.getpid()) >= 0
    assert waited_ns(0) == 0
