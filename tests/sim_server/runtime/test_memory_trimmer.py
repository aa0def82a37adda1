"""Memory is given back when there is some, and rarely tried when there is none."""

from zensim.sim_server.runtime.memory_trimmer import (
    EXCESS_BYTES,
    MAX_PERIOD_S,
    PERIOD_S,
    MemoryTrimmer,
)

START_BYTES = 100 << 20


class Process:
    """A process whose memory is in use or free."""

    def __init__(self) -> None:
        self.used = START_BYTES
        self.free = 0
        self.trims = 0

    def read(self) -> int:
        return self.used + self.free

    def trim(self) -> None:
        self.trims += 1
        self.free = 0


def a_process() -> tuple[Process, MemoryTrimmer]:
    process = Process()
    return process, MemoryTrimmer(process.read, process.trim)


def test_memory_that_is_free_again_is_given_back() -> None:
    process, trimmer = a_process()
    process.free = EXCESS_BYTES

    wait_s = trimmer.poll()

    assert (process.free, wait_s) == (0, PERIOD_S)


def test_little_memory_is_kept() -> None:
    process, trimmer = a_process()
    process.free = EXCESS_BYTES - 1

    trimmer.poll()

    assert process.trims == 0


def test_memory_in_use_is_trimmed_less_and_less_often() -> None:
    process, trimmer = a_process()
    process.used += EXCESS_BYTES

    waits_s = [trimmer.poll() for _ in range(10)]

    assert waits_s[:2] == [2 * PERIOD_S, 4 * PERIOD_S]
    assert waits_s[-1] == MAX_PERIOD_S
    process.used -= EXCESS_BYTES
    assert trimmer.poll() == PERIOD_S


def test_thread_ends_when_it_is_closed() -> None:
    _, trimmer = a_process()
    trimmer.start()

    trimmer.close()

    assert not trimmer._thread.is_alive()  # noqa: SLF001
