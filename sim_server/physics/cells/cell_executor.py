"""Executors that step, read and command cells: in process, by threads, by workers."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple, Protocol

import numpy as np

from zensim.sim_server.physics.cells.cell_worker_client import CellWorkerClient, RemoteCell
from zensim.sim_server.physics.cells.memory_reserve import MemoryReserve
from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray, SteppedTogether


class CellReadRequest(NamedTuple):
    """Bodies of a cell to read."""

    cell: Engine
    bodies: Sequence[int]


class CellTargets(NamedTuple):
    """Targets for bodies of a cell."""

    cell: Engine
    bodies: Sequence[int]
    targets: FloatArray


class CellExecutor(Protocol):
    """Makes engines for cells, and steps many of them at once."""

    def start(self) -> None:
        """Prepare for one more cell, without waiting."""

    def make(self) -> Engine:
        """Make an engine for a new cell."""

    def end(self, cell: Engine) -> None:
        """Close the engine of an empty cell."""

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        """Advance each cell by some steps; return whether all steps succeeded."""

    def read(self, requests: Sequence[CellReadRequest]) -> list[BodyStates]:
        """Read bodies of many cells."""

    def command(self, commands: Sequence[CellTargets]) -> None:
        """Set targets in many cells."""

    def close(self) -> None:
        """Free threads and processes, after the cells are closed."""


class StepThreads:
    """Steps engines in turn, or by threads."""

    def __init__(self, threads: int) -> None:
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def __getstate__(self) -> dict[str, object]:
        """Leave out the threads."""
        return {**self.__dict__, "_pool": None}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Make new threads, when they are used."""
        self.__dict__.update(state)
        self._pool = ThreadPoolExecutor(self._threads - 1) if self._threads > 1 else None

    def step(self, engines: Sequence[SteppedTogether], steps: int) -> bool:
        """Advance each by some steps; each free thread, this one included, takes the next."""
        if self._pool is None:
            return _step_cells(engines, steps)
        left = iter(engines)  # the GIL makes `next` atomic
        helpers = min(self._threads, len(engines)) - 1
        others = [self._pool.submit(_step_cells, left, steps) for _ in range(helpers)]
        is_ok = _step_cells(left, steps)
        return all([is_ok, *(other.result() for other in others)])

    def close(self) -> None:
        """End the threads."""
        if self._pool is not None:
            self._pool.shutdown()


class InProcessCellExecutor:
    """Cells in this process, stepped in turn or by threads."""

    def __init__(self, make: Callable[[], Engine], *, threads: int = 1) -> None:
        self.make = make
        self._threads = StepThreads(threads)

    def start(self) -> None:
        """See `CellExecutor.start`; does nothing."""

    def end(self, cell: Engine) -> None:
        """See `CellExecutor.end`."""
        cell.close()

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        """See `CellExecutor.step`; each free thread takes the next cell."""
        return self._threads.step(cells, steps)

    def read(self, requests: Sequence[CellReadRequest]) -> list[BodyStates]:
        """See `CellExecutor.read`."""
        return [cell.read(bodies) for cell, bodies in requests]

    def command(self, commands: Sequence[CellTargets]) -> None:
        """See `CellExecutor.command`."""
        for cell, bodies, targets in commands:
            cell.command(bodies, targets)

    def close(self) -> None:
        """See `CellExecutor.close`."""
        self._threads.close()


def _step_cells(cells: Iterable[SteppedTogether], steps: int) -> bool:
    # All steps of a cell in a row: its memory stays in the cache.
    is_ok = True
    for cell in cells:
        for _ in range(steps):
            is_ok &= cell.step()
    return is_ok


@dataclass(frozen=True)
class WorkerShare:
    """The cells of a call that belong to one worker.

    Attributes:
        places: Indices in the call.
        cells: Numbers of the cells in the worker.
    """

    places: list[int]
    cells: list[int]


class WorkerCellExecutor:
    """Cells shared evenly by this process and worker processes."""

    def __init__(
        self, make: Callable[[], Engine], orders: object, *, workers: int, cell_bytes: int = 0
    ) -> None:
        """Prepare to make cells.

        Args:
            make: Makes an engine in this process.
            orders: How a worker makes engines; pickled.
            workers: Number of workers to start with the second cell.
            cell_bytes: Memory that an engine writes to when it is made, if that takes long.
        """
        self._make = make
        self._orders = orders
        self._wanted = workers
        self._in_process = InProcessCellExecutor(make)
        self._own: list[Engine] = []
        self._workers: list[CellWorkerClient] = []
        self._numbers = count()
        self._reserve = MemoryReserve(cell_bytes)

    @property
    def process_ids(self) -> list[int]:
        """Process ids of the running workers."""
        return [worker.process_id for worker in self._workers]

    def start(self) -> None:
        """See `CellExecutor.start`; the first call of a worker waits for it."""
        self._start_workers()
        if self._find_next_worker() is None:
            self._reserve.prepare()

    def _start_workers(self) -> None:
        while len(self._workers) < self._wanted:
            self._workers.append(CellWorkerClient(self._orders, len(self._workers) + 1))

    def _find_next_worker(self) -> CellWorkerClient | None:
        """Find the worker that gets the next cell; None = this process."""
        emptiest = min(self._workers, key=lambda worker: worker.cells, default=None)
        return None if emptiest is None or len(self._own) < emptiest.cells else emptiest

    def make(self) -> Engine:
        """See `CellExecutor.make`; the process with the fewest cells gets it, a worker first."""
        if self._own:
            self._start_workers()
        if (emptiest := self._find_next_worker()) is None:
            self._reserve.release()
            self._own.append(self._make())
            return self._own[-1]
        emptiest.cells += 1
        return RemoteCell(emptiest, next(self._numbers), self._own[0].name)

    def end(self, cell: Engine) -> None:
        """See `CellExecutor.end`."""
        self._own = [one for one in self._own if one is not cell]
        cell.close()

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        """See `CellExecutor.step`."""
        own, shares = self._split_by_worker(cells)
        for worker, share in shares:
            worker.send("step", share.cells, steps)
        is_ok = self._in_process.step([cells[place] for place in own], steps)
        return all([is_ok, *(worker.wait_for_reply(bool) for worker, _ in shares)])

    def read(self, requests: Sequence[CellReadRequest]) -> list[BodyStates]:
        """See `CellExecutor.read`."""
        own, shares = self._split_by_worker([cell for cell, _ in requests])
        for worker, share in shares:
            wanted = [requests[place].bodies for place in share.places]
            worker.send("read", tuple(zip(share.cells, wanted, strict=True)))
        found = dict(
            zip(own, self._in_process.read([requests[place] for place in own]), strict=True)
        )
        for worker, share in shares:
            found.update(zip(share.places, worker.readings(), strict=True))
        return [found[place] for place in range(len(requests))]

    def command(self, commands: Sequence[CellTargets]) -> None:
        """See `CellExecutor.command`."""
        own, shares = self._split_by_worker([cell for cell, _, _ in commands])
        for worker, share in shares:
            own_commands = [commands[place] for place in share.places]
            bodies = [(one.bodies, len(one.targets)) for one in own_commands]
            targets = np.concatenate([one.targets for one in own_commands])
            worker.send_targets(tuple(zip(share.cells, bodies, strict=True)), targets)
        self._in_process.command([commands[place] for place in own])

    def close(self) -> None:
        """See `CellExecutor.close`."""
        for worker in self._workers:
            worker.close()
        self._workers.clear()
        self._reserve.release()

    def _split_by_worker(
        self, cells: Sequence[Engine]
    ) -> tuple[list[int], list[tuple[CellWorkerClient, WorkerShare]]]:
        """Split cells into indices of those in this process and a share for each worker."""
        own: list[int] = []
        shares: dict[int, tuple[CellWorkerClient, WorkerShare]] = {}
        for place, cell in enumerate(cells):
            if not isinstance(cell, RemoteCell):
                own.append(place)
                continue
            _, share = shares.setdefault(cell.worker.number, (cell.worker, WorkerShare([], [])))
            share.places.append(place)
            share.cells.append(cell.cell)
        return own, list(shares.values())
