"""Client of the parser process: non-blocking requests, deadlines, replacement on failure."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
from collections import deque
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

import msgspec

from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.parser_process.parser_protocol import (
    FRAME_LENGTH,
    ParsedMesh,
    ParseRequest,
    ParseResult,
    ParserMessage,
    ParserReady,
    encode_frame,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

UPDATE_PERIOD_NS = 10_000_000
MAX_UPDATE_NS = 1_000_000_000
"""Counted between two looks: who looks so seldom was stopped itself."""
MAX_SLOWDOWN = 6
"""A sixth of wall time counts on any machine, so that an answer comes."""


def read_run_queue_wait_ns(process_id: int) -> int:
    """Ask the kernel how long a process has waited for a core [ns]; 0 when it does not say."""
    try:
        text = Path(f"/proc/{process_id}/schedstat").read_text(encoding="ascii")
        return int(text.split()[1])
    except (OSError, IndexError, ValueError):
        return 0


class ParserClock:
    """A clock for one reader after another."""

    def __init__(
        self, now_ns: Callable[[], int], waited: Callable[[int], int] = read_run_queue_wait_ns
    ) -> None:
        self._wall_ns = now_ns
        self._waited = waited
        self._process_id = 0
        self._seen_ns = now_ns()
        self._seen_waited_ns = self._counted_ns = self._own_ns = 0
        self.now_ns = 0
        """Since this clock was made; never goes back."""

    def watch(self, process_id: int) -> None:
        """Go by another process from now on."""
        self._process_id = process_id
        self._seen_waited_ns = self._waited(process_id)

    def look(self, every_ns: int = UPDATE_PERIOD_NS) -> bool:
        """Go on by what has passed since the last look, if that is enough; say whether it was."""
        now_ns = self._wall_ns()
        passed_ns = min(now_ns - self._seen_ns, MAX_UPDATE_NS)
        if passed_ns < every_ns:
            return False
        waited_ns = self._waited(self._process_id)
        # The kernel adds a wait when it is over: what was counted until then is taken back.
        self._own_ns += passed_ns - (waited_ns - self._seen_waited_ns)
        self._counted_ns += passed_ns
        self._seen_ns, self._seen_waited_ns = now_ns, waited_ns
        self.now_ns = max(self.now_ns, self._own_ns, self._counted_ns // MAX_SLOWDOWN)
        return True


LOG = logging.getLogger(__name__)

WORKER_COMMAND = (sys.executable, "-m", "zensim.sim_server.parser_process.parser_worker")
DEADLINE_S = 9.0
"""From handing a request over to its answer, in the reader's own time: callers wait for 10 s."""
START_TIMEOUT_S = 60.0
TIMEOUT_MESSAGE = (
    f"reading took more than {DEADLINE_S:g} s; make the description smaller, or try again"
)
IDLE_POLL_NS = 250_000_000
"""Between two looks at a reader that has nothing to do."""
CHUNK_BYTES = 1 << 20
"""Written or read in one turn of the loop, at most."""
PARSER_NICENESS = 5
"""A third of the share of others: an answer comes, if late, where they have all cores."""
DECODER = msgspec.msgpack.Decoder(ParserMessage)


class AssetSource(Protocol):
    """Where the bytes of a sha256 are."""

    def size(self, sha256: str) -> int:
        """Length of a file."""

    def piece(self, sha256: str, offset: int, most: int) -> bytes:
        """Read a piece of a file."""


class ParserClient:
    """A reader process and the requests that wait for it."""

    def __init__(
        self, files: AssetSource, now_ns: Callable[[], int], command: Sequence[str] = WORKER_COMMAND
    ) -> None:
        self._files = files
        self._time = ParserClock(now_ns)
        self._command = command
        self._queue: deque[tuple[ParseRequest, int]] = deque()
        self._ended: list[subprocess.Popen[bytes]] = []
        self._has_been_ready = False
        """Until then the server waits for it."""
        # Kept: a buffer of this size would be mapped, and unmapped, at each reading.
        self._piece = bytearray(CHUNK_BYTES)
        self._begin()

    @property
    def process_id(self) -> int:
        """Of the reader that is up."""
        return self._process.pid

    @property
    def is_ready(self) -> bool:
        """Whether the process has started and reads nothing now."""
        return self._is_ready and self._current is None

    @property
    def _is_idle(self) -> bool:
        return self.is_ready and not self._queue

    def submit(self, request: ParseRequest) -> None:
        """Hand a request over; it is read after those before it."""
        self._time.look()
        self._queue.append((request, self._time.now_ns + round(DEADLINE_S * NANOSECONDS)))

    def poll(self) -> list[ParsedMesh | ParseResult]:
        """Move some bytes each way, and take what is read; one that is idle is looked at at times.

        The loop polls at every turn, and each question to the kernel costs it some microseconds.
        """
        if self._is_idle and not self._time.look(IDLE_POLL_NS):
            return []
        self._time.look()
        self._ended = [process for process in self._ended if process.poll() is None]
        answers = self._received()
        if self._process.poll() is not None:
            return answers + self._replace_exited()
        if self._time.now_ns > self._deadline_ns:
            return answers + self._replace_process(TIMEOUT_MESSAGE, slug="reader.timeout")
        answers += self._refuse_overdue()
        self._next()
        self._send()
        return answers

    def close(self) -> None:
        """End the process."""
        self._end()
        for process in self._ended:
            process.wait()

    def _begin(self) -> None:
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            bufsize=0,
            start_new_session=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"},
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._time.watch(self._process.pid)
        if self._has_been_ready:
            _lower_priority(self._process.pid)
        self._in, self._out = self._process.stdin.fileno(), self._process.stdout.fileno()
        for stream in (self._in, self._out):
            os.set_blocking(stream, False)
        self._current: ParseRequest | None = None
        self._is_ready = False
        self._outgoing = memoryview(b"")
        self._to_send: deque[tuple[str, int]] = deque()
        self._incoming = bytearray()
        self._deadline_ns = self._time.now_ns + round(START_TIMEOUT_S * NANOSECONDS)

    def _end(self) -> None:
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                stream.close()
        self._process.kill()
        self._ended.append(self._process)

    def _replace_exited(self) -> list[ParsedMesh | ParseResult]:
        status = self._process.returncode
        if status == -signal.SIGXCPU:
            return self._replace_process(TIMEOUT_MESSAGE, slug="reader.timeout")
        message = f"the reader ended (status {status}) over it; make it simpler"
        return self._replace_process(message, slug="reader.crashed")

    def _replace_process(self, message: str, *, slug: str) -> list[ParsedMesh | ParseResult]:
        current = self._current
        LOG.warning("reader replaced reason=%s status=%s", slug, self._process.returncode)
        self._end()
        self._begin()
        if current is None:
            return []
        return [_make_refusal(current, message, slug=slug)]

    def _next(self) -> None:
        if self._current is not None or not self._queue or not self._is_ready:
            return
        self._current, self._deadline_ns = self._queue.popleft()
        self._outgoing = memoryview(encode_frame(self._current))
        self._to_send = deque((sha256, -1) for sha256 in self._current.files)

    def _refuse_overdue(self) -> list[ParsedMesh | ParseResult]:
        """Refuse what has waited for too long behind others, or for a new reader to start."""
        answers: list[ParsedMesh | ParseResult] = []
        while self._queue and self._time.now_ns > self._queue[0][1]:
            late, _ = self._queue.popleft()
            answers.append(_make_refusal(late, TIMEOUT_MESSAGE, slug="reader.timeout"))
        return answers

    def _send(self) -> None:
        left = CHUNK_BYTES
        while left > 0 and (self._outgoing or self._fill_outgoing()):
            try:
                written = os.write(self._in, self._outgoing[:left])
            except (BlockingIOError, BrokenPipeError):
                return
            self._outgoing = self._outgoing[written:]
            left -= written

    def _fill_outgoing(self) -> bool:
        if not self._to_send:
            return False
        sha256, offset = self._to_send.popleft()
        size = self._files.size(sha256)
        if offset < 0:
            self._outgoing = memoryview(FRAME_LENGTH.pack(size))
        else:
            self._outgoing = memoryview(self._files.piece(sha256, offset, CHUNK_BYTES))
        following = max(offset, 0) if offset < 0 else offset + len(self._outgoing)
        if following < size:
            self._to_send.appendleft((sha256, following))
        return True

    def _received(self) -> list[ParsedMesh | ParseResult]:
        try:
            count = os.readv(self._out, [self._piece])
        except BlockingIOError:
            return []
        self._incoming += memoryview(self._piece)[:count]
        answers = []
        while (message := self._next_message()) is not None:
            if isinstance(message, ParserReady):
                self._has_been_ready = True
                _lower_priority(self._process.pid)
                self._mark_idle()
                continue
            if isinstance(message, ParseResult):
                self._mark_idle()
            answers.append(message)
        return answers

    def _mark_idle(self) -> None:
        self._is_ready = True
        self._current = None
        self._deadline_ns = sys.maxsize

    def _next_message(self) -> ParserMessage | None:
        if len(self._incoming) < FRAME_LENGTH.size:
            return None
        end = FRAME_LENGTH.size + FRAME_LENGTH.unpack_from(self._incoming)[0]
        if len(self._incoming) < end:
            return None
        message: ParserMessage = DECODER.decode(memoryview(self._incoming)[FRAME_LENGTH.size : end])
        self._incoming = self._incoming[end:]
        return message


def _make_refusal(request: ParseRequest, message: str, *, slug: str) -> ParseResult:
    return ParseResult(request.number, None, ResultCode.OPERATION_FAILED, slug, message)


def _lower_priority(process_id: int) -> None:
    """Let physics come first when cores are few."""
    with suppress(ProcessLookupError):
        os.setpriority(os.PRIO_PROCESS, process_id, PARSER_NICENESS)
    # Where the kernel shares cores among sessions, niceness counts inside of the reader's only.
    with suppress(OSError):
        Path(f"/proc/{process_id}/autogroup").write_text(str(PARSER_NICENESS), encoding="ascii")
