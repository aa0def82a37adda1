"""Who makes cells and works them: engines that know nothing of one another, worked together."""

from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple, Protocol

from zensim.sim_server.physics.engine import BodyStates, Engine, FloatArray


class Asked(NamedTuple):
    """Bodies of a cell that are to be read."""

    cell: Engine
    bodies: Sequence[int]


class Told(NamedTuple):
    """Targets for bodies of a cell."""

    cell: Engine
    bodies: Sequence[int]
    targets: FloatArray


class Cells(Protocol):
    """Makes engines for cells, and works many of them at once."""

    def start(self) -> None:
        """Get ready for more than one cell, and wait for nothing."""

    def make(self) -> Engine:
        """Make an engine for a new cell."""

    def end(self, cell: Engine) -> None:
        """Close the engine of a cell that nobody is in any more."""

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        """Advance cells by some steps each; say whether all is well in all of them."""

    def read(self, asked: Sequence[Asked]) -> list[BodyStates]:
        """Read bodies of many cells back."""

    def command(self, told: Sequence[Told]) -> None:
        """Set targets in many cells."""

    def close(self) -> None:
        """End what works cells; the cells are closed before."""


class CellsHere:
    """Cells in this process, one after the other, or by threads where an engine lets them run."""

    def __init__(self, make: Callable[[], Engine], *, threads: int = 1) -> None:
        self.make = make
        self._threads = threads
        self._pool = ThreadPoolExecutor(threads - 1) if threads > 1 else None

    def start(self) -> None:
        """See `Cells.start`: there is nothing to do."""

    def end(self, cell: Engine) -> None:
        """See `Cells.end`."""
        cell.close()

    def step(self, cells: Sequence[Engine], steps: int) -> bool:
        """See `Cells.step`; whichever thread is free takes the next cell, this one among them."""
        if self._pool is None:
            return _advance(cells, steps)
        left = iter(cells)  # the interpreter's lock lets each be taken once
        helpers = min(self._threads, len(cells)) - 1
        others = [self._pool.submit(_advance, left, steps) for _ in range(helpers)]
        is_well = _advance(left, steps)
        return all([is_well, *(other.result() for other in others)])

    def read(self, asked: Sequence[Asked]) -> list[BodyStates]:
        """See `Cells.read`."""
        return [cell.read(bodies) for cell, bodies in asked]

    def command(self, told: Sequence[Told]) -> None:
        """See `Cells.command`."""
        for cell, bodies, targets in told:
            cell.command(bodies, targets)

    def close(self) -> None:
        """See `Cells.close`."""
        if self._pool is not None:
            self._pool.shutdown()


def _advance(cells: Iterable[Engine], steps: int) -> bool:
    # One cell several times in a row: its memory is still near.
    is_well = True
    for cell in cells:
        for _ in range(steps):
            is_well &= cell.step()
    return is_well
