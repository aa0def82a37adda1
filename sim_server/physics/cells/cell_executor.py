"""Executors that step, read and command cells: in process, by threads, by workers."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import count
from typing import NamedTuple, Protocol

import numpy as np

from zensim.sim_server.physics.cells.cell_worker_client import CellWorkerClient, RemoteCell
from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray


class CellReadRequest(NamedTuple):
    """Bodies of a cell that are to be read."""

    cell: Engine
    bodies: Sequence[int]


class CellTargets(NamedTuple):
    """Targets for bodies of a cell."""

    cell: Engine
    bodies: Sequence[int]
    targets: FloatArray


class CellExecutor(Protocol):
    """Makes engines for cells, and works many of them at once."""

    def start(self) -> None:
        """Get ready for more than one cell, and wait for nothing."""

    def make(self) -> Engine:
        """Make an engine for a new cell."""

    def end(self, cell: Engine) -> None:
        """Close the engine of a cell that nobody is in any more."""

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        """Advance cells by some steps each; say whether all is well in all of them."""

    def read(self, asked: Sequence[CellReadRequest]) -> list[BodyStates]:
        """Read bodies of many cells back."""

    def command(self, told: Sequence[CellTargets]) -> None:
        """Set targets in many cells."""

    def close(self) -> None:
        """End what works cells; the cells are closed before."""


class InProcessCellExecutor:
    """Cells in this process, one after the other, or by threads where an engine lets them run."""

    def __init__(self, make: Callable[[], Engine], *, threads: int = 1) -> None:
        self.make = make
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def start(self) -> None:
        """See `CellExecutor.start`: there is nothing to do."""

    def end(self, cell: Engine) -> None:
        """See `CellExecutor.end`."""
        cell.close()

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        """See `CellExecutor.step`; whichever thread is free takes the next cell, this one among them."""
        if self._pool is None:
            return _step_cells(cells, steps)
        left = iter(cells)  # the interpreter's lock lets each be taken once
        helpers = min(self._threads, len(cells)) - 1
        others = [self._pool.submit(_step_cells, left, steps) for _ in range(helpers)]
        is_well = _step_cells(left, steps)
        return all([is_well, *(other.result() for other in others)])

    def read(self, asked: Sequence[CellReadRequest]) -> list[BodyStates]:
        """See `CellExecutor.read`."""
        return [cell.read(bodies) for cell, bodies in asked]

    def command(self, told: Sequence[CellTargets]) -> None:
        """See `CellExecutor.command`."""
        for cell, bodies, targets in told:
            cell.command(bodies, targets)

    def close(self) -> None:
        """See `CellExecutor.close`."""
        if self._pool is not None:
            self._pool.shutdown()


def _step_cells(cells: Iterable[Engine], steps: int) -> bool:
    # One cell several times in a row: its memory is still near.
    is_well = True
    for cell in cells:
        for _ in range(steps):
            is_well &= cell.step()
    return is_well


@dataclass(frozen=True)
class WorkerShare:
    """What a worker is to do, and where its part stands in what was asked.

    Attributes:
        places: Among what was asked.
        cells: Numbers that the worker knows them by.
    """

    places: list[int]
    cells: list[int]


class WorkerCellExecutor:
    """Cells, of which every worker has as many as this process."""

    def __init__(self, make: Callable[[], Engine], orders: object, *, workers: int) -> None:
        """Get ready to make cells.

        Args:
            make: Makes one here.
            orders: What a worker is told that it makes them by.
            workers: How many to start, once there is more than one cell.
        """
        self._make = make
        self._orders = orders
        self._wanted = workers
        self._here = InProcessCellExecutor(make)
        self._own: list[Engine] = []
        self._workers: list[CellWorkerClient] = []
        self._numbers = count()

    @property
    def process_ids(self) -> list[int]:
        """Of the workers that are up."""
        return [worker.process_id for worker in self._workers]

    def start(self) -> None:
        """Start the workers, if they are not up; they are waited for when they are asked."""
        while len(self._workers) < self._wanted:
            self._workers.append(CellWorkerClient(self._orders, len(self._workers) + 1))

    def make(self) -> Engine:
        """See `Cells.make`: whoever has least gets it, this process the first and then the last."""
        if self._own:
            self.start()
        least = min(self._workers, key=lambda worker: worker.cells, default=None)
        if least is None or len(self._own) < least.cells:
            self._own.append(self._make())
            return self._own[-1]
        least.cells += 1
        return RemoteCell(least, next(self._numbers), self._own[0].name)

    def end(self, cell: Engine) -> None:
        """See `Cells.end`: whoever had it has one less."""
        self._own = [one for one in self._own if one is not cell]
        cell.close()

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        """See `Cells.step`."""
        own, shares = self._split_by_worker(cells)
        for worker, share in shares:
            worker.send("step", share.cells, steps)
        is_well = self._here.step([cells[place] for place in own], steps)
        return all([is_well, *(worker.wait_for_reply(bool) for worker, _ in shares)])

    def read(self, asked: Sequence[CellReadRequest]) -> list[BodyStates]:
        """See `Cells.read`."""
        own, shares = self._split_by_worker([cell for cell, _ in asked])
        for worker, share in shares:
            wanted = [asked[place].bodies for place in share.places]
            worker.send("read", tuple(zip(share.cells, wanted, strict=True)))
        found = dict(zip(own, self._here.read([asked[place] for place in own]), strict=True))
        for worker, share in shares:
            found.update(zip(share.places, worker.readings(), strict=True))
        return [found[place] for place in range(len(asked))]

    def command(self, told: Sequence[CellTargets]) -> None:
        """See `Cells.command`."""
        own, shares = self._split_by_worker([cell for cell, _, _ in told])
        for worker, share in shares:
            mine = [told[place] for place in share.places]
            bodies = [(one.bodies, len(one.targets)) for one in mine]
            targets = np.concatenate([one.targets for one in mine])
            worker.send_targets(tuple(zip(share.cells, bodies, strict=True)), targets)
        self._here.command([told[place] for place in own])

    def close(self) -> None:
        """See `Cells.close`."""
        for worker in self._workers:
            worker.close()
        self._workers.clear()

    def _split_by_worker(
        self, cells: Sequence[Engine]
    ) -> tuple[list[int], list[tuple[CellWorkerClient, WorkerShare]]]:
        """Part what is asked: what is for cells of this process, and a share for each worker."""
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
