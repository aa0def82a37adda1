"""Cell worker process: hosts cells of a server and executes its calls.

`python -m zensim.sim_server.physics.cell_worker PIPE STATES TARGETS`: file descriptors of the pipe
to the server and of the shared memory. It exits when the server closes the pipe.
"""

import ctypes
import mmap
import pickle
import signal
import sys
from collections.abc import Iterator, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.cells.cell_worker_client import (
    CellTargetLayout,
    CellWorkerReply,
    SharedArray,
)
from zensim.sim_server.physics.cells.memory_reserve import is_glibc
from zensim.sim_server.physics.engine import (
    BodyStates,
    Engine,
    EngineRefused,
    FloatArray,
    concatenate_states,
    make_invalid_state,
    make_unknown_efforts,
)
from zensim.sim_server.physics.engine_factory import CellConfig

MIN_BLOCK_BYTES = 1 << 19
"""malloc maps blocks of at least this size one by one."""
RELEASE_CHUNK_BYTES = 1 << 16
"""Bytes that are compared with zero and released at once."""
ZEROS = bytes(RELEASE_CHUNK_BYTES)
M_MMAP_THRESHOLD, MADV_DONTNEED = -3, 4
MALLOC_IS_MMAPPED, MALLOC_FLAGS = 2, 7
"""Bits of the word before a block, which holds its size and flags."""
MALLOC_HEADER_BYTES = 2 * ctypes.sizeof(ctypes.c_size_t)


def use_mmap_for_large_blocks() -> bool:
    """Make malloc map each large block separately; return whether it does."""
    return is_glibc() and bool(ctypes.CDLL(None).mallopt(M_MMAP_THRESHOLD, MIN_BLOCK_BYTES))


class ZeroPages:
    """Pages of zeros in the large blocks of malloc: each block is searched once.

    A cell of PyBullet maps 20 MB that it hardly uses. To search the blocks of all cells for each
    new one takes the square of their number, and maps the released pages again.
    """

    def __init__(self) -> None:
        self._searched: frozenset[tuple[int, int]] = frozenset()

    def release(self) -> int:
        """Release those of new blocks; return how many bytes. Nothing if other threads run."""
        threads = Path("/proc/self/task")
        if not is_glibc() or not threads.is_dir() or len(list(threads.iterdir())) > 1:
            return 0
        blocks = [block for area in _anonymous_areas() for block in _mmapped_blocks(*area)]
        released = sum(_release(*block) for block in blocks if block not in self._searched)
        self._searched = frozenset(blocks)
        return released

    def forget(self) -> None:
        """Search all blocks next time: the system may have mapped a freed address again."""
        self._searched = frozenset()


def _release(start: int, end: int) -> int:
    """Release the chunks of zeros of a block; return how many bytes."""
    libc = ctypes.CDLL(None)
    advise, compare = libc.madvise, libc.memcmp
    advise.argtypes = (ctypes.c_void_p, ctypes.c_size_t, ctypes.c_int)
    compare.argtypes = (ctypes.c_void_p, ctypes.c_char_p, ctypes.c_size_t)
    released = 0
    for address in range(start, end - RELEASE_CHUNK_BYTES + 1, RELEASE_CHUNK_BYTES):
        is_zero = compare(address, ZEROS, RELEASE_CHUNK_BYTES) == 0
        if is_zero and advise(address, RELEASE_CHUNK_BYTES, MADV_DONTNEED) == 0:
            released += RELEASE_CHUNK_BYTES
    return released


def _anonymous_areas() -> Iterator[tuple[int, int]]:
    """List private anonymous memory of this process, adjacent mappings joined."""
    first = last = 0
    for line in Path("/proc/self/maps").read_text(encoding="ascii").splitlines():
        addresses, permissions, _, _, inode, *name = line.split()
        if permissions == "rw-p" and inode == "0" and not name:
            start, end = (int(number, 16) for number in addresses.split("-"))
            if start != last:
                yield first, last
                first = start
            last = end
    yield first, last


def _mmapped_blocks(start: int, end: int) -> Iterator[tuple[int, int]]:
    """List the whole pages of blocks that malloc mapped, and pass over what others mapped."""
    while start + MALLOC_HEADER_BYTES <= end:
        previous_size, word = (ctypes.c_size_t * 2).from_address(start)
        size = word & ~MALLOC_FLAGS
        is_block = (
            previous_size == 0
            and word & MALLOC_FLAGS == MALLOC_IS_MMAPPED
            and size % mmap.PAGESIZE == 0
        )
        if is_block and MIN_BLOCK_BYTES <= size <= end - start:
            yield start + mmap.PAGESIZE, start + size
            start += size
        else:
            start += mmap.PAGESIZE


FORWARDED_METHODS = (
    "set_base_state",
    "set_at_rest",
    "set_state",
    "apply_link_wrench",
    "apply_joint_effort",
)
"""Methods of `Engine` about one body that return nothing."""


class HostedCell:
    """The engine of a cell.

    Attributes:
        models: Model of each body.
        lost: Bodies that the engine refused although the server relied on it; read as NaN.
        faults: Of those, the reasons that the server does not know yet.
    """

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.models: dict[int, Model] = {}
        self.lost: set[int] = set()
        self.faults: dict[int, str] = {}

    def lose(self, body: int, model: Model, reason: str) -> None:
        """Record a body that the engine does not have."""
        self.models[body], self.faults[body] = model, reason
        self.lost.add(body)

    def discard(self, body: int) -> None:
        """Remove a body."""
        del self.models[body]
        self.faults.pop(body, None)
        if body in self.lost:
            self.lost.remove(body)
        else:
            self.engine.discard(body)

    def take_faults(self) -> dict[int, str]:
        """Take the faults of the engine and of lost bodies."""
        found, self.faults = {**self.engine.take_faults(), **self.faults}, {}
        return found

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """Read bodies; lost ones have NaN."""
        if self.lost.isdisjoint(bodies):
            return self.engine.read(bodies)
        return concatenate_states([self._read_one(body) for body in bodies])

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        """Read the efforts of joints; lost bodies have NaN."""
        if self.lost.isdisjoint(bodies):
            return self.engine.read_joint_efforts(bodies)
        return np.concatenate([np.zeros(0), *(self._read_efforts_of(body) for body in bodies)])

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """Set the targets of bodies; those of lost ones have no effect."""
        if not self.lost.isdisjoint(bodies):
            widths = [make_actuation(self.models[body]).width for body in bodies]
            targets = targets[np.repeat([body not in self.lost for body in bodies], widths)]
        self.engine.command(self.list_present(bodies), targets)

    def list_present(self, bodies: Sequence[int]) -> Sequence[int]:
        """List bodies without those that are lost."""
        if not self.lost:
            return bodies
        return [body for body in bodies if body not in self.lost]

    def _read_one(self, body: int) -> BodyStates:
        if body in self.lost:
            return make_invalid_state(self.models[body])
        return self.engine.read((body,))

    def _read_efforts_of(self, body: int) -> FloatArray:
        if body in self.lost:
            return make_unknown_efforts(len(self.models[body].joints))
        return self.engine.read_joint_efforts((body,))


class CellWorker:
    """The cells of this process, by the server's numbers."""

    def __init__(
        self, connection: "Connection[Any, Any]", states: SharedArray, targets: SharedArray
    ) -> None:
        self._connection = connection
        self._states, self._targets = states, targets
        self._cells: dict[int, HostedCell] = {}
        self._config: CellConfig | None = None
        self._model: Model | None = None
        self._zero_pages = ZeroPages()

    def run(self) -> None:
        """Execute calls until the server closes the pipe."""
        while True:
            try:
                calls = self._connection.recv()
            except EOFError:
                return
            for call in calls:
                self._dispatch(*pickle.loads(call))

    def _dispatch(self, method: str, arguments: tuple[Any, ...]) -> None:
        if method in FORWARDED_METHODS:
            number, body, *rest = arguments
            cell = self._cells[number]
            if body not in cell.lost:
                getattr(cell.engine, method)(body, *rest)
            return
        try:
            reply = getattr(self, f"_{method}")(*arguments)
        except EngineRefused as refused:
            reply = CellWorkerReply(refused=str(refused))
        if reply is not None:
            self._connection.send(reply)

    def _begin(self, config: CellConfig) -> None:
        use_mmap_for_large_blocks()
        self._config = config

    def _model_is(self, model: Model) -> None:
        self._model = model

    def _make(self, cell: int) -> None:
        assert self._config is not None
        self._cells[cell] = HostedCell(self._config.make())
        self._zero_pages.release()

    def _hide(self, cell: int, body: int) -> None:
        hosted = self._cells[cell]
        if body not in hosted.lost:
            hosted.engine.hide(body)

    def _show(self, cell: int, bodies: Sequence[int]) -> None:
        hosted = self._cells[cell]
        hosted.engine.show(hosted.list_present(bodies))

    def _close(self, cell: int) -> None:
        self._cells.pop(cell).engine.close()
        self._zero_pages.forget()

    def _confirm(self) -> CellWorkerReply:
        """Reply: all calls of before are executed."""
        return CellWorkerReply(value=True)

    def _prepare(self, cell: int) -> CellWorkerReply:
        assert self._model is not None
        return CellWorkerReply(self._cells[cell].engine.prepare(self._model))

    def _insert(self, cell: int, body: int, base: FloatArray) -> CellWorkerReply:
        assert self._model is not None
        hosted = self._cells[cell]
        hosted.engine.insert(body, self._model, base)
        hosted.models[body] = self._model
        return CellWorkerReply(value=True)

    def _insert_another(self, cell: int, body: int, base: FloatArray) -> None:
        assert self._model is not None
        try:
            self._insert(cell, body, base)
        except EngineRefused as refused:
            # The model was accepted before, so the server does not wait for a reply.
            self._cells[cell].lose(body, self._model, str(refused))

    def _discard(self, cell: int, body: int) -> None:
        self._cells[cell].discard(body)

    def _forget_removed(self, cell: int) -> None:
        self._cells[cell].engine.forget_removed()

    def _take_faults(self, cell: int) -> CellWorkerReply:
        return CellWorkerReply(self._cells[cell].take_faults())

    def _read_contacts(self, cell: int, bodies: Sequence[int]) -> CellWorkerReply:
        hosted = self._cells[cell]
        return CellWorkerReply(hosted.engine.read_contacts(hosted.list_present(bodies)))

    def _read_joint_efforts(self, cell: int, bodies: Sequence[int]) -> CellWorkerReply:
        return CellWorkerReply(self._cells[cell].read_joint_efforts(bodies))

    def _find_overlaps(self, cell: int, body: int) -> CellWorkerReply:
        hosted = self._cells[cell]
        if body in hosted.lost:
            return CellWorkerReply([])
        return CellWorkerReply(list(hosted.engine.find_overlaps(body)))

    def _step(self, cells: Sequence[int], steps: int) -> CellWorkerReply:
        is_valid = True
        for cell in cells:
            for _ in range(steps):
                is_valid &= self._cells[cell].engine.step() and not self._cells[cell].lost
        return CellWorkerReply(is_valid)

    def _read(self, requests: Sequence[tuple[int, Sequence[int]]]) -> CellWorkerReply:
        cells = ((self._cells[cell], bodies) for cell, bodies in requests)
        found = [hosted.read(bodies) for hosted, bodies in cells]
        arrays = [(one.base, one.joint_positions, one.joint_velocities) for one in found]
        self._states.write([array for three in arrays for array in three])
        return CellWorkerReply([(len(one.base), one.joint_positions.size) for one in found])

    def _command(self, layouts: Sequence[CellTargetLayout]) -> None:
        targets = self._targets.read([count for _, (_, count) in layouts])
        for (cell, (bodies, _)), own in zip(layouts, targets, strict=True):
            self._command_one(cell, bodies, own)

    def _command_one(self, cell: int, bodies: Sequence[int], targets: FloatArray) -> None:
        self._cells[cell].command(bodies, targets)


def main() -> None:
    """Run until the server ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    pipe, states, targets = map(int, sys.argv[1:])
    CellWorker(Connection(pipe), SharedArray(states), SharedArray(targets)).run()


if __name__ == "__main__":
    main()
