"""Cells of which this process has some and workers have the others, all stepped at once."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import count

import numpy as np

from zensim.sim_server.physics.clusters.cells import Asked, CellsHere, Told
from zensim.sim_server.physics.clusters.worker import RemoteCell, Worker
from zensim.sim_server.physics.engine import BodyStates, Engine


@dataclass(frozen=True)
class Share:
    """What a worker is to do, and where its part stands in what was asked.

    Attributes:
        places: Among what was asked.
        cells: Numbers that the worker knows them by.
    """

    places: list[int]
    cells: list[int]


class CellsOfWorkers:
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
        self._here = CellsHere(make)
        self._own: list[Engine] = []
        self._workers: list[Worker] = []
        self._numbers = count()

    @property
    def process_ids(self) -> list[int]:
        """Of the workers that are up."""
        return [worker.process_id for worker in self._workers]

    def start(self) -> None:
        """Start the workers, if they are not up; they are waited for when they are asked."""
        while len(self._workers) < self._wanted:
            self._workers.append(Worker(self._orders, len(self._workers) + 1))

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
        own, shares = self._shared(cells)
        for worker, share in shares:
            worker.tell("step", share.cells, steps)
        is_well = self._here.step([cells[place] for place in own], steps)
        return all([is_well, *(worker.answer(bool) for worker, _ in shares)])

    def read(self, asked: Sequence[Asked]) -> list[BodyStates]:
        """See `Cells.read`."""
        own, shares = self._shared([cell for cell, _ in asked])
        for worker, share in shares:
            wanted = [asked[place].bodies for place in share.places]
            worker.tell("read", tuple(zip(share.cells, wanted, strict=True)))
        found = dict(zip(own, self._here.read([asked[place] for place in own]), strict=True))
        for worker, share in shares:
            found.update(zip(share.places, worker.readings(), strict=True))
        return [found[place] for place in range(len(asked))]

    def command(self, told: Sequence[Told]) -> None:
        """See `Cells.command`."""
        own, shares = self._shared([cell for cell, _, _ in told])
        for worker, share in shares:
            mine = [told[place] for place in share.places]
            bodies = [(one.bodies, len(one.targets)) for one in mine]
            targets = np.concatenate([one.targets for one in mine])
            worker.tell_targets(tuple(zip(share.cells, bodies, strict=True)), targets)
        self._here.command([told[place] for place in own])

    def close(self) -> None:
        """See `Cells.close`."""
        for worker in self._workers:
            worker.close()
        self._workers.clear()

    def _shared(self, cells: Sequence[Engine]) -> tuple[list[int], list[tuple[Worker, Share]]]:
        """Part what is asked: what is for cells of this process, and a share for each worker."""
        own: list[int] = []
        shares: dict[int, tuple[Worker, Share]] = {}
        for place, cell in enumerate(cells):
            if not isinstance(cell, RemoteCell):
                own.append(place)
                continue
            _, share = shares.setdefault(cell.worker.number, (cell.worker, Share([], [])))
            share.places.append(place)
            share.cells.append(cell.cell)
        return own, list(shares.values())
