"""A worker: a process that has some of a server's cells, and does what it is told with them.

`python -m sim_server.physics.working LINE STATES TARGETS`: descriptors of its line to the server,
and of the memory that they share. It ends with the server: its line is closed then.
"""

import signal
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any

from proto.model import Model
from sim_server.physics.clusters.sharing import Board
from sim_server.physics.clusters.worker import Answer, CellTold
from sim_server.physics.engine import Concealing, Engine, EngineRefused, FloatArray
from sim_server.physics.making import CellOrders

SIMPLE = ("remove", "forget_removed", "place", "rest", "put", "push_link", "push_joint")
"""What a cell is told as an engine is; nothing comes of it."""


class Working:
    """Cells by the numbers that the server knows them by."""

    def __init__(self, line: "Connection[Any, Any]", states: Board, targets: Board) -> None:
        self._line = line
        self._states, self._targets = states, targets
        self._cells: dict[int, Engine] = {}
        self._orders: CellOrders | None = None
        self._model: Model | None = None

    def run(self) -> None:
        """Do what is told until the server closes its end."""
        while True:
            try:
                what, given = self._line.recv()
            except EOFError:
                return
            self._do(what, given)

    def _do(self, what: str, given: tuple[Any, ...]) -> None:
        if what in SIMPLE:
            cell, *arguments = given
            getattr(self._cells[cell], what)(*arguments)
            return
        try:
            answer = getattr(self, f"_{what}")(*given)
        except EngineRefused as refused:
            answer = Answer(refused=str(refused))
        if answer is not None:
            self._line.send(answer)

    def _begin(self, orders: CellOrders) -> None:
        self._orders = orders

    def _model_is(self, model: Model) -> None:
        self._model = model

    def _make(self, cell: int) -> Answer:
        assert self._orders is not None
        made = self._cells[cell] = self._orders.make()
        return Answer(made.name)

    def _conceal(self, cell: int, body: int) -> None:
        if isinstance(engine := self._cells[cell], Concealing):
            engine.conceal(body)

    def _reveal(self, cell: int, bodies: Sequence[int]) -> None:
        if isinstance(engine := self._cells[cell], Concealing):
            engine.reveal(bodies)

    def _close(self, cell: int) -> None:
        self._cells.pop(cell).close()

    def _prepare(self, cell: int) -> Answer:
        assert self._model is not None
        return Answer(self._cells[cell].prepare(self._model))

    def _add(self, cell: int, base: FloatArray) -> Answer:
        assert self._model is not None
        return Answer(self._cells[cell].add(self._model, base))

    def _overlapping(self, cell: int, body: int) -> Answer:
        return Answer(list(self._cells[cell].overlapping(body)))

    def _step(self, cells: Sequence[int], steps: int) -> Answer:
        is_well = True
        for cell in cells:
            for _ in range(steps):
                is_well &= self._cells[cell].step()
        return Answer(is_well)

    def _read(self, asked: Sequence[tuple[int, Sequence[int]]]) -> Answer:
        found = [self._cells[cell].read(bodies) for cell, bodies in asked]
        arrays = [(one.base, one.joint_positions, one.joint_velocities) for one in found]
        self._states.write([array for three in arrays for array in three])
        return Answer([(len(one.base), one.joint_positions.size) for one in found])

    def _command(self, told: Sequence[CellTold]) -> None:
        targets = self._targets.read([count for _, (_, count) in told])
        for (cell, (bodies, _)), mine in zip(told, targets, strict=True):
            self._cells[cell].command(bodies, mine)

    def _command_one(self, cell: int, bodies: Sequence[int], targets: FloatArray) -> None:
        self._cells[cell].command(bodies, targets)


def main() -> None:
    """Work until the server ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    line, states, targets = map(int, sys.argv[1:])
    Working(Connection(line), Board(states), Board(targets)).run()


if __name__ == "__main__":
    main()
