"""Client of a cell worker process: calls over a pipe, arrays in shared memory."""

import mmap
import os
import pickle
import select
import socket
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import Any, Generic, NamedTuple, TypeVar

import numpy as np

from zensim.proto.child_process import SINGLE_THREADED, make_module_command, start_process
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.physics.engine import (
    BodyStates,
    ContactPoints,
    Engine,
    EngineCapabilities,
    EngineLost,
    EngineRefused,
    FloatArray,
)

MAX_NUMBERS = 1 << 23
"""Capacity of a shared array; pages that are never written take no memory."""
Kind = TypeVar("Kind")
CellTargetLayout = tuple[int, tuple[Sequence[int], int]]
"""Number of a cell, its bodies, and the number of their targets."""
WORKER_MODULE = "zensim.sim_server.physics.cell_worker"
MAX_QUEUED_CALLS = 32
"""Calls that are sent together, unless a reply is needed before."""
MAX_QUICK_LINKS = 8


class SharedArray:
    """Floats in memory that processes share by a file descriptor."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        self._memory = mmap.mmap(descriptor, 8 * MAX_NUMBERS)
        self._numbers: FloatArray = np.frombuffer(self._memory, dtype=np.float64)

    def write(self, arrays: Sequence[FloatArray]) -> None:
        """Write arrays one after the other.

        Raises:
            ValueError: They do not fit.
        """
        if (count := sum(array.size for array in arrays)) > MAX_NUMBERS:
            raise ValueError(f"{count} numbers do not fit; at most {MAX_NUMBERS} do")
        at = 0
        for array in arrays:
            self._numbers[at : at + array.size] = array.reshape(-1)
            at += array.size

    def read(self, sizes: Sequence[int]) -> list[FloatArray]:
        """Copy arrays of these sizes, as written one after the other."""
        ends = np.cumsum(sizes, dtype=np.intp)
        return np.split(self._numbers[: int(ends[-1]) if len(ends) else 0].copy(), ends[:-1])

    def close(self) -> None:
        """Release the memory."""
        self._numbers = np.zeros(0)
        self._memory.close()
        os.close(self.descriptor)


def make_shared_array() -> SharedArray:
    """Make a shared array."""
    descriptor = os.memfd_create("zensim", os.MFD_CLOEXEC)
    os.ftruncate(descriptor, 8 * MAX_NUMBERS)
    return SharedArray(descriptor)


class CellWorkerDied(EngineLost):
    """A worker process ended, and its cells are lost."""


class CellWorkerReply(NamedTuple):
    """The reply of a worker to a call.

    Attributes:
        value: Result of the call.
        refused: Message of `EngineRefused`; empty = not raised.
        fault: Message of any other error; empty = none.
    """

    value: object = None
    refused: str = ""
    fault: str = ""


class PendingReply(Generic[Kind]):
    """The future reply to a call."""

    def __init__(self, worker: "CellWorkerClient", kind: type[Kind]) -> None:
        self._worker = worker
        self._kind = kind
        self.reply: CellWorkerReply | None = None

    def wait(self) -> Kind:
        """Wait for the result; raises as `CellWorkerClient.wait_for_reply` does."""
        while self.reply is None:
            self._worker.receive_reply()
        return self._worker.unwrap(self.reply, self._kind)


class CellWorkerClient:
    """A worker process, and calls to it over a pipe."""

    def __init__(self, orders: object, number: int) -> None:
        """Start a worker; it is ready when it replies.

        Args:
            orders: How the worker makes engines; pickled.
            number: Names it in errors.
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
        self._pipe: Connection[Any, Any] = Connection(here.detach())
        self._model: Model | None = None
        self._queued: list[bytes] = []
        self._is_confirmed = True
        """Whether a reply follows all calls of before."""
        self._pending_replies: deque[PendingReply[Any]] = deque()
        self.send("begin", orders)

    @property
    def process_id(self) -> int:
        """Process id of the worker."""
        return self._process.pid

    def send(self, what: str, *given: object) -> None:
        """Send a call now, without waiting for its reply.

        Raises:
            CellWorkerDied: The process ended.
        """
        self._queue_call(what, given)
        self._flush()

    def enqueue(self, what: str, *given: object) -> None:
        """Queue a call; it is sent before later calls; raises as `send` does."""
        self._queue_call(what, given)
        self._is_confirmed = False
        if len(self._queued) >= MAX_QUEUED_CALLS:
            self._flush_if_writable()

    def select_model(self, model: Model) -> None:
        """Set the model that later calls refer to."""
        if self._model is not model:
            self._model = model
            self.enqueue("model_is", model)

    def call_async(self, kind: type[Kind], what: str, *given: object) -> PendingReply[Kind]:
        """Queue a call, and return its future reply."""
        pending = PendingReply(self, kind)
        self._pending_replies.append(pending)
        self.enqueue(what, *given)
        return pending

    def is_idle(self) -> bool:
        """Whether all calls are executed; if that is not known, the worker is asked."""
        self._flush_if_writable()
        if not (self._is_confirmed or self._pending_replies):
            self.call_async(bool, "confirm")
            self._is_confirmed = True
            self._flush_if_writable()
        return not (self._queued or self._pending_replies)

    def receive_reply(self) -> None:
        """Wait for the next pending reply."""
        if self._queued:
            self._flush()
        self._pending_replies.popleft().reply = self._receive()

    def wait_for_reply(self, kind: type[Kind]) -> Kind:
        """Wait for the result of the last call, of type `kind`.

        Raises:
            EngineRefused: The engine refused the call.
            CellWorkerDied: The process ended, or the call failed.
        """
        while self._pending_replies:
            self.receive_reply()
        reply = self._receive()
        self._is_confirmed = not self._queued
        return self.unwrap(reply, kind)

    def unwrap(self, reply: CellWorkerReply, kind: type[Kind]) -> Kind:
        """Return the value of a reply; raises as `wait_for_reply` does."""
        if reply.refused:
            raise EngineRefused(reply.refused)
        if reply.fault:
            raise CellWorkerDied(f"engine worker {self.number} failed: {reply.fault}")
        assert isinstance(reply.value, kind)
        return reply.value

    def call(self, kind: type[Kind], what: str, *given: object) -> Kind:
        """Send a call and wait for its result."""
        self.send(what, *given)
        return self.wait_for_reply(kind)

    def send_targets(self, layouts: Sequence[CellTargetLayout], targets: FloatArray) -> None:
        """Set targets, concatenated cell by cell in this order."""
        self._targets.write([targets])
        self.send("command", layouts)

    def readings(self) -> list[BodyStates]:
        """Wait for the states of a read call, cell by cell."""
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
        self._pipe.close()
        self._process.kill()
        self._process.wait()
        self._states.close()
        self._targets.close()

    def _queue_call(self, what: str, given: tuple[object, ...]) -> None:
        # Pickle now: the arrays may change before the call is sent.
        self._queued.append(pickle.dumps((what, given), pickle.HIGHEST_PROTOCOL))

    def _flush_if_writable(self) -> None:
        """Send queued calls and receive replies as far as that does not block."""
        try:
            while self._pending_replies and self._pipe.poll():
                self.receive_reply()
        except OSError as error:
            raise self._died_error() from error
        if self._queued and select.select((), (self._pipe,), (), 0.0)[1]:
            self._flush()

    def _flush(self) -> None:
        queued, self._queued = self._queued, []
        try:
            self._pipe.send(queued)
        except OSError as error:
            raise self._died_error() from error

    def _receive(self) -> CellWorkerReply:
        try:
            reply: CellWorkerReply = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise self._died_error() from error
        return reply

    def _died_error(self) -> CellWorkerDied:
        status = self._process.poll()
        with_status = "" if status is None else f" with status {status}"
        return CellWorkerDied(
            f"engine worker {self.number} ended{with_status}, and its robots with it"
        )


class RemoteCell(Engine):
    """The Engine of a cell in a worker."""

    capabilities = EngineCapabilities(hides=True, is_remote=True)

    def __init__(self, worker: CellWorkerClient, cell: int, name: str) -> None:
        self.worker = worker
        self.cell = cell
        self._name = name
        self._accepted: Model | None = None
        worker.enqueue("make", cell)

    @property
    def name(self) -> str:
        """See `Engine.name`."""
        return self._name

    def prepare(self, model: Model) -> bool:
        """See `Engine.prepare`; not asked for what PyBullet adds in less than the round trip."""
        is_quick = len(model.links) <= MAX_QUICK_LINKS and not _has_meshes(model)
        if self._name == "pybullet" and is_quick:
            return True
        self.worker.select_model(model)
        return self.worker.call(bool, "prepare", self.cell)

    def skip_validation(self, model: Model) -> None:
        """See `Engine.skip_validation`; not for meshes, whose files may be deleted meanwhile."""
        if model is not self._accepted and not _has_meshes(model):
            self._accepted = model

    def insert(self, body: int, model: Model, base: FloatArray) -> None:
        """See `Engine.insert`; does not wait for a model that was accepted before."""
        self.worker.select_model(model)
        if model is self._accepted:
            self.worker.enqueue("insert_another", self.cell, body, base)
        else:
            self.worker.call(bool, "insert", self.cell, body, base)
            self._accepted = model

    def discard(self, body: int) -> None:
        """See `Engine.discard`."""
        self.worker.enqueue("discard", self.cell, body)

    def hide(self, body: int) -> None:
        """See `Engine.hide`; has no effect if the worker's engine cannot hide."""
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

    def read_contacts(self, bodies: Sequence[int]) -> ContactPoints:
        """See `Engine.read_contacts`."""
        return self.worker.call(ContactPoints, "read_contacts", self.cell, bodies)

    def read_joint_efforts(self, bodies: Sequence[int]) -> FloatArray:
        """See `Engine.read_joint_efforts`."""
        return self.worker.call(np.ndarray, "read_joint_efforts", self.cell, bodies)

    def take_faults(self) -> Mapping[int, str]:
        """See `Engine.take_faults`."""
        return self.worker.call(dict, "take_faults", self.cell)

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
