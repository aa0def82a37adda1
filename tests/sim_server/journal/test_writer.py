"""Writer: records in order, together where they came together, and none after one that failed."""

import sqlite3
import threading
from collections.abc import Sequence

import pytest

from tests.integration.processes import eventually
from zensim.sim_server.journal.records import Record
from zensim.sim_server.journal.writer import Writer


class GatedDisk:
    """Writes only when let."""

    def __init__(self) -> None:
        self.gate = threading.Semaphore(0)
        self.batches: list[list[int]] = []
        self.fault: Exception | None = None
        self.is_closed = False

    def keep(self, records: Sequence[Record]) -> None:
        assert self.gate.acquire(timeout=10.0)
        if self.fault is not None:
            raise self.fault
        self.batches.append([record.position for record in records])

    def close(self) -> None:
        self.is_closed = True


def test_writer_puts_what_came_meanwhile_into_one_batch() -> None:
    disk = GatedDisk()
    writer = Writer(disk, 0)
    for position in (1, 2):
        writer.submit(Record(0, position))
    writer.start()
    disk.gate.release()
    eventually(lambda: writer.durable == 2, 10.0, "the first batch")
    disk.gate.release(9)
    writer.submit(Record(0, 3))

    assert writer.close()
    assert disk.batches == [[1, 2], [3]]
    assert (writer.durable, writer.commits, disk.is_closed) == (3, 2, True)


def test_writer_says_nothing_is_durable_before_it_is() -> None:
    disk = GatedDisk()
    writer = Writer(disk, 5)
    writer.start()
    writer.submit(Record(0, 6))

    assert writer.durable == 5
    disk.gate.release()
    eventually(lambda: writer.durable == 6, 10.0, "the batch")
    assert writer.close()


@pytest.mark.parametrize(
    "fault", [sqlite3.OperationalError("database or disk is full"), OSError(28, "No space left")]
)
def test_writer_drops_all_of_a_generation_that_failed(fault: Exception) -> None:
    disk = GatedDisk()
    disk.fault = fault
    writer = Writer(disk, 0)
    writer.start()
    writer.submit(Record(0, 1))
    disk.gate.release(9)
    eventually(lambda: writer.failure, 10.0, "the failure")
    disk.fault = None
    writer.submit(Record(0, 2))
    writer.submit(Record(1, 1))

    assert writer.close()
    assert writer.failure is not None
    assert writer.failure[0] == 0
    assert disk.batches == [[1]]
    assert writer.durable == 1


def test_writer_does_not_wait_for_ever_at_its_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("zensim.sim_server.journal.writer.END_S", 0.05)
    disk = GatedDisk()
    writer = Writer(disk, 0)
    writer.start()
    writer.submit(Record(0, 1))

    assert not writer.close()
    disk.gate.release(9)
    eventually(lambda: not writer.is_alive, 10.0, "the end")
