"""Client of a cell worker process: calls over a pipe, arrays in shared memory."""

import mmap
import os
import pickle
import select
import socket
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from itertools import count
from multiprocessing.connection import Connection
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from zensim.proto.child_process import SINGLE_THREADED, make_module_command, start_process
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.engine import (
    BodyStates,
    Engine,
    EngineCapabilities,
    EngineRefused,
    FloatArray,
)

MAX_NUMBERS = 1 << 23
"""Room on a board: what is not written takes no memory."""


class SharedArray:
    """An array of numbers in memory that is shared by its file descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, 8 * MAX_NUMBERS)
        self._numbers: FloatArray = np.frombuffer(self._memory, dtype=np.float64)

    def write(self, arrays: Sequence[FloatArray]) -> None:
        """Write arrays one after the other.

        Raises:
            ValueError: There is no room for them.
        """
        if (count := sum(array.size for array in arrays)) > MAX_NUMBERS:
            raise ValueError(f"{count} numbers do not fit; a board has room for {MAX_NUMBERS}")
        at = 0
        for array in arrays:
            self._numbers[at : at + array.size] = array.reshape(-1)
            at += array.size

    def read(self, sizes: Sequence[int]) -> list[FloatArray]:
        """Copy arrays of these sizes, which were written one after the other."""
        ends = np.cumsum(sizes, dtype=np.intp)
        return np.split(self._numbers[: int(ends[-1]) if len(ends) else 0].copy(), ends[:-1])

    def close(self) -> None:
        """Let go of the memory."""
        self._numbers = np.zeros(0)
        self._memory.close()
        os.close(self.descriptor)


def make_shared_array() -> SharedArray:
    """Make memory for a board."""
    descriptor = os.memfd_create("zensim", os.MFD_CLOEXEC)
    os.ftruncate(descriptor, 8 * MAX_NUMBERS)
    return SharedArray(descriptor)


Kind = TypeVar("Kind")
CellTargetLayout = tuple[int, tuple[Sequence[int], int]]
"""A cell by number, its bodies, and how many targets they have together."""

WORKER_MODULE = "zensim.sim_server.physics.cell_worker"
MAX_QUEUED_CALLS = 32
"""Orders that are held back to be sent together, unless something is asked before."""


class CellWorkerDied(RuntimeError):
    """A worker is no more, and its cells with it."""


class CellWorkerReply(NamedTuple):
    """What a worker says.

    Attributes:
        value: What was asked for.
        refused: Why the engine cannot do it; empty when it did.
        fault: What went wrong; empty when nothing did.
    """

    value: object = None
    refused: str = ""
    fault: str = ""


class PendingReply(Generic[Kind]):
    """What a worker was asked and has perhaps not answered yet."""

    def __init__(self, worker: "CellWorkerClient", kind: type[Kind]) -> None:
        self._worker = worker
        self._kind = kind
        self.answer: CellWorkerReply | None = None

    def wait(self) -> Kind:
        """Wait for what was asked; raises as `CellWorkerClient.answer` does."""
        while self.answer is None:
            self._worker.receive_reply()
        return self._worker.unwrap(self.answer, self._kind)


class CellWorkerClient:
    """A process with cells."""

    def __init__(self, orders: object, number: int) -> None:
        """Start one; it is ready when it answers.

        Args:
            orders: What it is told first: how to make a cell.
            number: What people call it.
        """
        self.number = number
        self.cells = 0
        self._states, self._targets = make_shared_array(), make_shared_array()
        here, there = socket.socketpair()
        passed = (there.fileno(), self._states.descriptor, self._targets.descriptor)
        self._process = start_process(
            make_module_command(WORKER_MODULE, *map(str, passed)),
            pass_fds=passed,
            environment=SINGLE_THREADED,
        )
        there.close()
        self._line: Connection[Any, Any] = Connection(here.detach())
        self._model: Model | None = None
        self._queued: list[bytes] = []
        self._pending_replies: deque[PendingReply[Any]] = deque()
        self.send("begin", orders)

    @property
    def process_id(self) -> int:
        """Of the worker."""
        return self._process.pid

    def send(self, what: str, *given: object) -> None:
        """Have something done at once, and wait for nothing.

        Raises:
            WorkerEnded: It is no more.
        """
        self._queue_call(what, given)
        self._flush()

    def enqueue(self, what: str, *given: object) -> None:
        """Have something done before anything that is told later; raises as `tell` does."""
        self._queue_call(what, given)
        if len(self._queued) >= MAX_QUEUED_CALLS:
            self._flush_if_writable()

    def select_model(self, model: Model) -> None:
        """Have the worker know which model is meant from now on."""
        if self._model is not model:
            self._model = model
            self.enqueue("model_is", model)

    def call_async(self, kind: type[Kind], what: str, *given: object) -> PendingReply[Kind]:
        """Have something done as `enqueue` does, and get what comes of it later."""
        promise = PendingReply(self, kind)
        self._pending_replies.append(promise)
        self.enqueue(what, *given)
        return promise

    def is_idle(self) -> bool:
        """Whether all that it was told is sent, and all that it was asked is answered."""
        self._flush_if_writable()
        return not (self._queued or self._pending_replies)

    def receive_reply(self) -> None:
        """Wait for the next answer that was promised."""
        if self._queued:
            self._flush()
        self._pending_replies.popleft().answer = self._receive()

    def wait_for_reply(self, kind: type[Kind]) -> Kind:
        """Wait for what was asked, which is of a kind.

        Raises:
            EngineRefused: The engine cannot do it.
            WorkerEnded: It is no more, or something went wrong in it.
        """
        while self._pending_replies:
            self.receive_reply()
        return self.unwrap(self._receive(), kind)

    def unwrap(self, answer: CellWorkerReply, kind: type[Kind]) -> Kind:
        """Take an answer apart; raises as `answer` does."""
        if answer.refused:
            raise EngineRefused(answer.refused)
        if answer.fault:
            raise CellWorkerDied(f"engine worker {self.number} failed: {answer.fault}")
        assert isinstance(answer.value, kind)
        return answer.value

    def call(self, kind: type[Kind], what: str, *given: object) -> Kind:
        """Have something done and wait for what comes of it."""
        self.send(what, *given)
        return self.wait_for_reply(kind)

    def send_targets(self, told: Sequence[CellTargetLayout], targets: FloatArray) -> None:
        """Have targets set, cell by cell; they are chained in this order."""
        self._targets.write([targets])
        self.send("command", told)

    def readings(self) -> list[BodyStates]:
        """Wait for what was asked to be read, cell by cell."""
        counts = self.wait_for_reply(list)
        sizes = [size for rows, joints in counts for size in (13 * rows, joints, joints)]
        found = self._states.read(sizes)
        return [
            BodyStates(base.reshape(-1, 13), positions, velocities)
            for base, positions, velocities in zip(
                found[0::3], found[1::3], found[2::3], strict=True
            )
        ]

    def close(self) -> None:
        """End the process."""
        self._line.close()
        self._process.kill()
        self._process.wait()
        self._states.close()
        self._targets.close()

    def _queue_call(self, what: str, given: tuple[object, ...]) -> None:
        # At once: arrays may be others by the time that they are sent.
        self._queued.append(pickle.dumps((what, given), pickle.HIGHEST_PROTOCOL))

    def _flush_if_writable(self) -> None:
        """Send what is held, unless that would wait for the worker; take what it has answered."""
        try:
            while self._pending_replies and self._line.poll():
                self.receive_reply()
        except OSError as error:
            raise self._died_error() from error
        if self._queued and select.select((), (self._line,), (), 0.0)[1]:
            self._flush()

    def _flush(self) -> None:
        held, self._queued = self._queued, []
        try:
            self._line.send(held)
        except OSError as error:
            raise self._died_error() from error

    def _receive(self) -> CellWorkerReply:
        try:
            answer: CellWorkerReply = self._line.recv()
        except (EOFError, OSError) as error:
            raise self._died_error() from error
        return answer

    def _died_error(self) -> CellWorkerDied:
        status = self._process.poll()
        said = "" if status is None else f" with status {status}"
        return CellWorkerDied(f"engine worker {self.number} ended{said}, and its robots with it")


class RemoteCell(Engine):
    """The Engine of a cell that a worker has; it numbers bodies itself and so waits for none."""

    capabilities = EngineCapabilities(hides=True, is_remote=True)

    def __init__(self, worker: CellWorkerClient, cell: int, name: str) -> None:
        self.worker = worker
        self.cell = cell
        self._name = name
        self._numbers = count()
        self._taken: Model | None = None
        worker.enqueue("make", cell)

    @property
    def name(self) -> str:
        """See `Engine.name`."""
        return self._name

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`."""
        self.worker.select_model(model)
        return self.worker.call(bool, "prepare", self.cell)

    def skip_validation(self, model: Model) -> None:
        """See `Engine.skip_validation`; files of meshes may be gone by the time that they are read here."""
        if model is not self._taken and not _has_meshes(model):
            self._taken = model

    def add(self, model: Model, base: FloatArray) -> int:
        """See `Engine.add`; a model that was taken before is not waited for."""
        self.worker.select_model(model)
        number = next(self._numbers)
        if model is self._taken:
            self.worker.enqueue("add_another", self.cell, number, base)
        else:
            self.worker.call(bool, "add", self.cell, number, base)
            self._taken = model
        return number

    def remove(self, body: int) -> None:
        """See `Engine.remove`."""
        self.worker.enqueue("remove", self.cell, body)

    def hide(self, body: int) -> None:
        """See `Engine.hide`; a worker's engine that cannot lets the body be."""
        self.worker.enqueue("hide", self.cell, body)

    def show(self, bodies: Sequence[int]) -> None:
        """See `Engine.show`."""
        self.worker.enqueue("show", self.cell, bodies)

    def forget_removed(self) -> None:
        """See `Engine.forget_removed`."""
        self.worker.enqueue("forget_removed", self.cell)

    def find_overlaps(self, body: int) -> Sequence[int]:
        """See `Engine.find_overlaps`."""
        return self.worker.call(list, "find_overlaps", self.cell, body)

    def find_overlaps_async(self, body: int) -> Callable[[], Sequence[int]]:
        """See `Engine.find_overlaps_async`."""
        return self.worker.call_async(list, "find_overlaps", self.cell, body).wait

    def is_idle(self) -> bool:
        """See `Engine.is_idle`."""
        return self.worker.is_idle()

    def read(self, bodies: Sequence[int]) -> BodyStates:
        """See `Engine.read`."""
        self.worker.send("read", ((self.cell, bodies),))
        return self.worker.readings()[0]

    def set_base_state(self, body: int, base: FloatArray) -> None:
        """See `Engine.set_base_state`."""
        self.worker.enqueue("set_base_state", self.cell, body, base)

    def set_at_rest(self, body: int, base: FloatArray, positions: FloatArray | None = None) -> None:
        """See `Engine.set_at_rest`."""
        self.worker.enqueue("set_at_rest", self.cell, body, base, positions)

    def set_state(
        self, body: int, base: FloatArray, positions: FloatArray, velocities: FloatArray
    ) -> None:
        """See `Engine.set_state`."""
        self.worker.enqueue("set_state", self.cell, body, base, positions, velocities)

    def command(self, bodies: Sequence[int], targets: FloatArray) -> None:
        """See `Engine.command`."""
        self.worker.enqueue("command_one", self.cell, bodies, np.asarray(targets))

    def apply_link_wrench(self, body: int, link: int, wrench: FloatArray) -> None:
        """See `Engine.apply_link_wrench`."""
        self.worker.enqueue("apply_link_wrench", self.cell, body, link, wrench)

    def apply_joint_effort(self, body: int, joint: int, effort: float) -> None:
        """See `Engine.apply_joint_effort`."""
        self.worker.enqueue("apply_joint_effort", self.cell, body, joint, effort)

    def step(self) -> bool:
        """See `Engine.step`."""
        return self.worker.call(bool, "step", (self.cell,), 1)

    def close(self) -> None:
        """See `Engine.close`."""
        self.worker.cells -= 1
        with suppress(CellWorkerDied):
            self.worker.send("close", self.cell)


def _has_meshes(model: Model) -> bool:
    return any(shape.mesh for link in model.links for shape in link.collisions)
