"""Cell worker process: hosts cells of a server and executes its calls.

`python -m zensim.sim_server.physics.cell_worker PIPE STATES TARGETS`: file descriptors of the pipe
to the server and of the shared memory. It exits when the server closes the pipe.
"""

import pickle
import signal
import sys
from collections.abc import Sequence
from multiprocessing.connection import Connection
from typing import Any

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.cells.cell_worker_client import (
    CellTargetLayout,
    CellWorkerReply,
    SharedArray,
)
from zensim.sim_server.physics.engine import Engine, EngineRefused, FloatArray
from zensim.sim_server.physics.engine_factory import CellConfig
from zensim.sim_server.physics.memory_trim import release_zero_pages, use_mmap_for_large_blocks

FORWARDED_METHODS = (
    "set_base_state",
    "set_at_rest",
    "set_state",
    "apply_link_wrench",
    "apply_joint_effort",
)
"""What a cell is told of a body as an engine is; nothing comes of it."""


class HostedCell:
    """An engine, and what the server calls its bodies.

    Attributes:
        inner: The engine's number of each body, by the server's.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.engine_numbers: dict[int, int] = {}

    def to_engine_numbers(self, bodies: Sequence[int]) -> tuple[int, ...]:
        """Find the engine's numbers of bodies."""
        return tuple([self.engine_numbers[body] for body in bodies])

    def to_server_numbers(self, inners: Sequence[int]) -> list[int]:
        """Find the server's numbers of bodies."""
        outer = {inner: body for body, inner in self.engine_numbers.items()}
        return [outer[inner] for inner in inners]


class CellWorker:
    """Cells by the numbers that the server knows them by."""

    def __init__(
        self, line: "Connection[Any, Any]", states: SharedArray, targets: SharedArray
    ) -> None:
        self._connection = line
        self._states, self._targets = states, targets
        self._cells: dict[int, HostedCell] = {}
        self._config: CellConfig | None = None
        self._model: Model | None = None

    def run(self) -> None:
        """Do what is told until the server closes its end."""
        while True:
            try:
                told = self._connection.recv()
            except EOFError:
                return
            for order in told:
                self._dispatch(*pickle.loads(order))

    def _dispatch(self, what: str, given: tuple[Any, ...]) -> None:
        if what in FORWARDED_METHODS:
            cell, body, *arguments = given
            known = self._cells[cell]
            getattr(known.engine, what)(known.engine_numbers[body], *arguments)
            return
        try:
            answer = getattr(self, f"_{what}")(*given)
        except EngineRefused as refused:
            answer = CellWorkerReply(refused=str(refused))
        if answer is not None:
            self._connection.send(answer)

    def _begin(self, orders: CellConfig) -> None:
        use_mmap_for_large_blocks()
        self._config = orders

    def _model_is(self, model: Model) -> None:
        self._model = model

    def _make(self, cell: int) -> None:
        assert self._config is not None
        self._cells[cell] = HostedCell(self._config.make())
        release_zero_pages()

    def _hide(self, cell: int, body: int) -> None:
        known = self._cells[cell]
        known.engine.hide(known.engine_numbers[body])

    def _show(self, cell: int, bodies: Sequence[int]) -> None:
        known = self._cells[cell]
        known.engine.show(known.to_engine_numbers(bodies))

    def _close(self, cell: int) -> None:
        self._cells.pop(cell).engine.close()

    def _prepare(self, cell: int) -> CellWorkerReply:
        assert self._model is not None
        return CellWorkerReply(self._cells[cell].engine.prepare(self._model))

    def _add(self, cell: int, body: int, base: FloatArray) -> CellWorkerReply:
        self._add_body(cell, body, base)
        return CellWorkerReply(value=True)

    def _add_another(self, cell: int, body: int, base: FloatArray) -> None:
        try:
            self._add_body(cell, body, base)
        except EngineRefused as refused:
            # It took others of this model, and nobody waits for what it says of this one.
            raise RuntimeError(f"body {body} of cell {cell}: {refused}") from refused

    def _add_body(self, cell: int, body: int, base: FloatArray) -> None:
        assert self._model is not None
        known = self._cells[cell]
        known.engine_numbers[body] = known.engine.add(self._model, base)

    def _remove(self, cell: int, body: int) -> None:
        known = self._cells[cell]
        known.engine.remove(known.engine_numbers.pop(body))

    def _forget_removed(self, cell: int) -> None:
        self._cells[cell].engine.forget_removed()

    def _find_overlaps(self, cell: int, body: int) -> CellWorkerReply:
        known = self._cells[cell]
        return CellWorkerReply(
            known.to_server_numbers(known.engine.find_overlaps(known.engine_numbers[body]))
        )

    def _step(self, cells: Sequence[int], steps: int) -> CellWorkerReply:
        is_well = True
        for cell in cells:
            for _ in range(steps):
                is_well &= self._cells[cell].engine.step()
        return CellWorkerReply(is_well)

    def _read(self, asked: Sequence[tuple[int, Sequence[int]]]) -> CellWorkerReply:
        cells = ((self._cells[cell], bodies) for cell, bodies in asked)
        found = [known.engine.read(known.to_engine_numbers(bodies)) for known, bodies in cells]
        arrays = [(one.base, one.joint_positions, one.joint_velocities) for one in found]
        self._states.write([array for three in arrays for array in three])
        return CellWorkerReply([(len(one.base), one.joint_positions.size) for one in found])

    def _command(self, told: Sequence[CellTargetLayout]) -> None:
        targets = self._targets.read([count for _, (_, count) in told])
        for (cell, (bodies, _)), mine in zip(told, targets, strict=True):
            self._command_one(cell, bodies, mine)

    def _command_one(self, cell: int, bodies: Sequence[int], targets: FloatArray) -> None:
        known = self._cells[cell]
        known.engine.command(known.to_engine_numbers(bodies), targets)


def main() -> None:
    """Work until the server ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    line, states, targets = map(int, sys.argv[1:])
    CellWorker(Connection(line), SharedArray(states), SharedArray(targets)).run()


if __name__ == "__main__":
    main()
