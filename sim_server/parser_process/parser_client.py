"""Client of the parser process: non-blocking requests, deadlines, replacement on failure."""

from __future__ import annotations

import logging
import sys
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec

from zensim.proto.child_process import (
    CHUNK_BYTES,
    FRAME_LENGTH,
    FramedProcess,
    encode_frame,
    make_module_command,
)
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.process_limits import OUT_OF_CPU_TIME_STATUS, set_niceness
from zensim.sim_server.errors import AssetRefused
from zensim.sim_server.parser_process.parser_protocol import (
    MAX_CPU_S,
    ParsedMesh,
    ParseRequest,
    ParseResult,
    ParserMessage,
    ParserReady,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

UPDATE_PERIOD_NS = 10_000_000
MAX_UPDATE_NS = 1_000_000_000
"""Most time that one update adds: after a longer gap the server itself was stopped."""
MAX_SLOWDOWN = 6
"""The clock advances by at least a sixth of wall time, so that every request ends."""


def read_run_queue_wait_ns(process_id: int) -> int:
    """Read how long a process has waited for a core [ns]; 0 if the kernel does not report it."""
    try:
        text = Path(f"/proc/{process_id}/schedstat").read_text(encoding="ascii")
        return int(text.split()[1])
    except (OSError, IndexError, ValueError):
        return 0


class ParserClock:
    """Wall time without the time that the parser process waited for a core."""

    def __init__(
        self,
        wall_ns: Callable[[], int],
        read_wait_ns: Callable[[int], int] = read_run_queue_wait_ns,
    ) -> None:
        self._wall_ns = wall_ns
        self._read_wait_ns = read_wait_ns
        self._process_id = 0
        self._updated_ns = wall_ns()
        self._last_wait_ns = self._elapsed_ns = self._own_ns = 0
        self.now_ns = 0
        """Time since the clock was made; never decreases."""

    def track(self, process_id: int) -> None:
        """Follow another process from now on."""
        self._process_id = process_id
        self._last_wait_ns = self._read_wait_ns(process_id)

    def update(self, min_period_ns: int = UPDATE_PERIOD_NS) -> bool:
        """Advance the clock if the last update is old enough; return whether it was."""
        wall_ns = self._wall_ns()
        passed_ns = min(wall_ns - self._updated_ns, MAX_UPDATE_NS)
        if passed_ns < min_period_ns:
            return False
        wait_ns = self._read_wait_ns(self._process_id)
        # The kernel adds a wait when it is over: what was counted until then is subtracted.
        self._own_ns += passed_ns - (wait_ns - self._last_wait_ns)
        self._elapsed_ns += passed_ns
        self._updated_ns, self._last_wait_ns = wall_ns, wait_ns
        self.now_ns = max(self.now_ns, self._own_ns, self._elapsed_ns // MAX_SLOWDOWN)
        return True


LOG = logging.getLogger(__name__)

WORKER_COMMAND = make_module_command("zensim.sim_server.parser_process.parser_worker")
DEADLINE_S = 9.0
"""Longest time from a request to its result, in the parser's own time, which on a busy host is up
to six times as long; callers time out after 10 s. What the parser computes is limited by
`MAX_CPU_S`, which is less: whoever exceeds this one waited."""
START_TIMEOUT_S = 60.0
TIMEOUT_MESSAGE = (
    f"parsing took more than {MAX_CPU_S} s of CPU time; make the description or its meshes smaller"
)
BUSY_MESSAGE = (
    f"parsing was not done in time, with less than {MAX_CPU_S} s of CPU time: this host is busy, "
    "or has no memory, files or processes left; try again"
)
RESTART_NS = 500_000_000
"""Time until a process that could not be started is tried again."""
MAX_IN_FLIGHT = 16
"""Requests that the process has been sent and not replied to; the next is read without a turn."""
IDLE_POLL_NS = 250_000_000
"""Period of polling an idle process."""
PARSER_NICENESS = 5
"""A third of the share of others: results arrive, if late, where all cores are busy."""
DECODER = msgspec.msgpack.Decoder(ParserMessage)


class AssetSource(Protocol):
    """Access to files by sha256."""

    def size(self, sha256: str) -> int:
        """Return the length of a file [bytes]."""

    def read(self, sha256: str, offset: int, max_bytes: int) -> bytes:
        """Read a part of a file."""


class ParserClient:
    """A parser process and the queue of requests to it."""

    def __init__(
        self, files: AssetSource, now_ns: Callable[[], int], command: Sequence[str] = WORKER_COMMAND
    ) -> None:
        self._files = files
        self._clock = ParserClock(now_ns)
        self._command = command
        self._queue: deque[tuple[ParseRequest, int]] = deque()
        self._killed: list[FramedProcess] = []
        self._has_been_ready = False
        """Whether the process was ready; until then it keeps its priority, as the server waits."""
        self._start()

    @property
    def process_id(self) -> int:
        """Process id of the current process."""
        return self._process.process_id

    @property
    def is_ready(self) -> bool:
        """Whether the process has started and parses nothing now."""
        return self._is_ready and not self._in_flight

    @property
    def _is_idle(self) -> bool:
        return self.is_ready and not self._queue

    def submit(self, request: ParseRequest) -> None:
        """Queue a request."""
        self._clock.update()
        self._queue.append((request, self._clock.now_ns + round(DEADLINE_S * NANOSECONDS)))

    def poll(self) -> list[ParsedMesh | ParseResult]:
        """Exchange some bytes with the process and return what it has parsed; never blocks.

        The loop polls at every turn, and each system call costs it some microseconds: an idle
        process is polled every `IDLE_POLL_NS` only.
        """
        if self._is_idle and not self._clock.update(IDLE_POLL_NS):
            return []
        self._clock.update()
        self._killed = [process for process in self._killed if process.poll() is None]
        if self._is_missing:
            return self._poll_without_process()
        results = self._receive()
        if (status := self._process.poll()) is not None:
            # What it sent between both calls: the oldest text left is to blame.
            results += self._receive()
            return results + self._replace_exited(status)
        if self._clock.now_ns > self._due_ns:
            return results + self._replace_process(BUSY_MESSAGE, slug="reader.busy")
        results += self._refuse_overdue()
        try:
            self._send_next()
            self._process.flush()
        except AssetRefused as error:
            # The process waits for the rest of a file that cannot be read.
            results += self._replace_process(error.fault, slug=error.slug)
        return results

    def close(self) -> None:
        """End the process."""
        self._kill()
        for process in self._killed:
            process.wait()

    def _start(self) -> None:
        self._in_flight: deque[tuple[ParseRequest, int]] = deque()
        self._is_ready = self._is_missing = False
        self._process = FramedProcess(self._command)
        self._clock.track(self.process_id)
        if self._has_been_ready:
            set_niceness(PARSER_NICENESS, self.process_id)
        self._deadline_ns = self._clock.now_ns + round(START_TIMEOUT_S * NANOSECONDS)

    @property
    def _due_ns(self) -> int:
        """Time until which the process must reply to its oldest request, or start."""
        return self._in_flight[0][1] if self._in_flight else self._deadline_ns

    def _start_again(self) -> None:
        """Start a process, or wait until the system has files and processes for one."""
        try:
            self._start()
        except OSError as error:
            LOG.warning("parser process not started reason=%s", error)
            self._is_missing = True
            self._clock.track(0)
            self._deadline_ns = self._clock.now_ns + RESTART_NS

    def _poll_without_process(self) -> list[ParsedMesh | ParseResult]:
        if self._clock.now_ns > self._deadline_ns:
            self._start_again()
        return self._refuse_overdue()

    def _kill(self) -> None:
        self._process.kill()
        self._killed.append(self._process)

    def _replace_exited(self, status: int) -> list[ParsedMesh | ParseResult]:
        if status == OUT_OF_CPU_TIME_STATUS:
            return self._replace_process(TIMEOUT_MESSAGE, slug="reader.timeout")
        message = f"the parser process ended (status {status}) over it; make it simpler"
        return self._replace_process(message, slug="reader.crashed")

    def _replace_process(self, message: str, *, slug: str) -> list[ParsedMesh | ParseResult]:
        """Refuse the oldest request, which the process was busy with; the others are sent again."""
        LOG.warning("parser process replaced reason=%s status=%s", slug, self._process.poll())
        self._kill()
        blamed = self._in_flight.popleft()[0] if self._in_flight else None
        self._queue.extendleft(reversed(self._in_flight))
        self._start_again()
        return [] if blamed is None else [_make_refusal(blamed, message, slug=slug)]

    def _send_next(self) -> None:
        while self._is_ready and self._queue and self._may_send(self._queue[0][0]):
            self._in_flight.append(self._queue.popleft())
            self._process.send(self._encode_request(self._in_flight[-1][0]))

    def _may_send(self, request: ParseRequest) -> bool:
        """Whether a request may follow those in flight; one with files is alone.

        A file that cannot be read must end no other request.
        """
        if not self._in_flight:
            return True
        has_files = bool(request.files or self._in_flight[-1][0].files)
        return len(self._in_flight) < MAX_IN_FLIGHT and not has_files

    def _encode_request(self, request: ParseRequest) -> Iterator[bytes]:
        yield encode_frame(msgspec.msgpack.encode(request))
        for sha256 in request.files:
            size = self._files.size(sha256)
            yield FRAME_LENGTH.pack(size)
            for offset in range(0, size, CHUNK_BYTES):
                yield self._files.read(sha256, offset, CHUNK_BYTES)

    def _refuse_overdue(self) -> list[ParsedMesh | ParseResult]:
        """Refuse requests that waited too long for others, or for a new process to start."""
        refusals: list[ParsedMesh | ParseResult] = []
        while self._queue and self._clock.now_ns > self._queue[0][1]:
            overdue, _ = self._queue.popleft()
            refusals.append(_make_refusal(overdue, BUSY_MESSAGE, slug="reader.busy"))
        return refusals

    def _receive(self) -> list[ParsedMesh | ParseResult]:
        results = []
        for frame in self._process.receive():
            message = DECODER.decode(frame)
            if isinstance(message, ParserReady):
                self._has_been_ready = True
                # Physics comes first when cores are few.
                set_niceness(PARSER_NICENESS, self.process_id)
                self._is_ready, self._deadline_ns = True, sys.maxsize
                continue
            if isinstance(message, ParseResult):
                self._in_flight.popleft()
            results.append(message)
        return results


def _make_refusal(request: ParseRequest, message: str, *, slug: str) -> ParseResult:
    return ParseResult(request.number, None, ResultCode.OPERATION_FAILED, slug, message)
