"""Child processes: start, run once, exchange frames without blocking, run in a fork, end."""

import os
import select
import struct
import subprocess
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from typing import IO, NamedTuple, NoReturn, Protocol, TypeVar

from zensim.proto.parent_death import SIGKILL, die_with_parent
from zensim.proto.process_limits import KILLED_STATUS, OUT_OF_CPU_TIME_STATUS

FRAME_LENGTH = struct.Struct("<Q")
"""Precedes the bytes of each frame."""
CHUNK_BYTES = 1 << 20
"""Most bytes that one call reads or writes without blocking."""
SINGLE_THREADED = {"OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1"}
"""Environment of a process whose array library must use one core only."""
STDIN, STDOUT, STDERR = 0, 1, 2
END_POLL_S = 0.01
FORK_REPORT = struct.Struct("<I")
NO_REPLY = 1
"""Status of a copy that ended with status 0 instead of a reply."""
CAN_COPY = sys.platform == "linux"
"""Whether a process can be copied with libraries of the system in it; macOS and Windows cannot."""


def make_module_command(module: str, *arguments: str) -> tuple[str, ...]:
    """Make the command that runs a module with this interpreter."""
    return (sys.executable, "-m", module, *arguments)


def start_process(
    command: Sequence[str],
    *,
    stdin: int = subprocess.DEVNULL,
    stdout: int = subprocess.DEVNULL,
    stderr: int | None = None,
    pass_fds: Sequence[int] = (),
    environment: Mapping[str, str] | None = None,
) -> "subprocess.Popen[bytes]":
    """Start a process in its own session, so that Ctrl-C reaches the parent only.

    Args:
        command: Program and arguments.
        stdin: As for `subprocess.Popen`.
        stdout: As for `subprocess.Popen`; pipes are not buffered.
        stderr: As for `subprocess.Popen`.
        pass_fds: File descriptors that the child inherits.
        environment: Variables to add to this process's own.
    """
    return subprocess.Popen(
        command,
        stdin=stdin,
        stdout=stdout,
        stderr=stderr,
        bufsize=0,
        pass_fds=pass_fds,
        start_new_session=True,
        env={**os.environ, **(environment or {})},
    )


class ProcessOutcome(NamedTuple):
    """Exit status and output of a process that has ended; the status is negative for a signal."""

    status: int
    output: bytes

    @property
    def is_out_of_time(self) -> bool:
        """Whether the process exceeded its deadline or its CPU time."""
        return self.status in (OUT_OF_CPU_TIME_STATUS, KILLED_STATUS)


def run_process(
    command: Sequence[str],
    request: bytes,
    *,
    timeout_s: float | None = None,
    environment: Mapping[str, str] | None = None,
) -> ProcessOutcome:
    """Run a process that reads a request from stdin and writes a reply to stdout.

    It is killed at the timeout, and when the caller is interrupted.
    """
    with start_process(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, environment=environment
    ) as process:
        try:
            output, _ = process.communicate(request, timeout_s)
        except subprocess.TimeoutExpired:
            process.kill()
            return ProcessOutcome(KILLED_STATUS, b"")
        except BaseException:
            process.kill()
            process.wait()
            raise
    return ProcessOutcome(process.returncode, output)


class Process(Protocol):
    """A child process: `subprocess.Popen`, or `AdoptedProcess` of `process_copies`."""

    pid: int

    @property
    def returncode(self) -> int | None:
        """Exit status as of the last `poll` or `wait`, negative for a signal."""

    @property
    def stdin(self) -> IO[bytes] | None:
        """Pipe to it."""

    @property
    def stdout(self) -> IO[bytes] | None:
        """Pipe from it."""

    def poll(self) -> int | None:
        """Find the exit status; None while it runs."""

    def wait(self) -> int:
        """Block until it has ended; return its status."""

    def terminate(self) -> None:
        """Send SIGTERM."""

    def kill(self) -> None:
        """Send SIGKILL."""


ProcessT = TypeVar("ProcessT", bound=Process)


def end_processes(grace_s: Mapping[ProcessT, float]) -> None:
    """Send SIGTERM in this order, again at half of each time [s], SIGKILL after it; reap all.

    At the second SIGTERM a server ends without finishing the requests that it has accepted.
    """
    began_s = time.monotonic()
    for process in grace_s:
        process.terminate()
    left, patient = dict(grace_s), dict(grace_s)
    while left:
        passed_s = time.monotonic() - began_s
        for process in [one for one, most_s in patient.items() if passed_s >= most_s / 2]:
            del patient[process]
            process.terminate()  # nothing is sent to one that has ended
        left = {one: most_s for one, most_s in left.items() if not _end(one, most_s - passed_s)}
        if left:
            time.sleep(END_POLL_S)
    for process in grace_s:
        close_pipes(process)


def _end(process: Process, left_s: float) -> bool:
    """Kill a process that has no time left; return whether it has ended."""
    if process.poll() is None and left_s <= 0.0:
        process.kill()
        process.wait()
    return process.returncode is not None


def close_pipes(process: Process) -> None:
    """Close the parent's ends of a child's stdin and stdout."""
    for stream in (process.stdin, process.stdout):
        if stream is not None:
            stream.close()


class FramedProcess:
    """A child process that exchanges frames over stdin and stdout; no call blocks."""

    def __init__(self, command: Sequence[str], *, stderr: int | None = subprocess.DEVNULL) -> None:
        """Start it; arguments as of `start_process`."""
        self._process = start_process(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=stderr,
            environment=SINGLE_THREADED,
        )
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._stdin, self._stdout = self._process.stdin.fileno(), self._process.stdout.fileno()
        for stream in (self._stdin, self._stdout):
            os.set_blocking(stream, False)
        self._queue: deque[Iterator[bytes]] = deque()
        self._chunk = memoryview(b"")
        self._incoming = bytearray()
        # Allocated once: a buffer of this size is mapped and unmapped at each allocation.
        self._buffer = bytearray(CHUNK_BYTES)

    @property
    def process_id(self) -> int:
        """Process id of the child."""
        return self._process.pid

    def poll(self) -> int | None:
        """Find the exit status, negative for a signal; None while the process runs."""
        return self._process.poll()

    def send(self, chunks: Iterable[bytes]) -> None:
        """Queue chunks of frames; each is requested when the pipe has room for it."""
        self._queue.append(iter(chunks))

    def flush(self) -> None:
        """Write what the pipe accepts now, at most `CHUNK_BYTES`."""
        room = CHUNK_BYTES
        while room > 0 and (self._chunk or self._next_chunk()):
            try:
                written = os.write(self._stdin, self._chunk[:room])
            except (BlockingIOError, BrokenPipeError):
                return
            self._chunk = self._chunk[written:]
            room -= written

    def receive(self) -> list[bytes]:
        """Read what the pipe holds, at most `CHUNK_BYTES`, and return the complete frames."""
        try:
            self._incoming += self._read_chunk()
        except BlockingIOError:
            return []
        frames = []
        while (frame := self._next_frame()) is not None:
            frames.append(frame)
        return frames

    def kill(self) -> None:
        """Close the pipes and kill the process and its group; `poll` or `wait` reaps it."""
        close_pipes(self._process)
        if hasattr(os, "killpg") and self.poll() is None:
            # macOS refuses it for a process that has just ended.
            with suppress(PermissionError):
                os.killpg(self.process_id, SIGKILL)
        self._process.kill()

    def wait(self) -> None:
        """Block until the process has ended."""
        self._process.wait()

    def _read_chunk(self) -> bytes | memoryview:
        if not hasattr(os, "readv"):
            return os.read(self._stdout, CHUNK_BYTES)
        count = os.readv(self._stdout, [self._buffer])
        return memoryview(self._buffer)[:count]

    def _next_chunk(self) -> bool:
        while self._queue:
            if (chunk := next(self._queue[0], None)) is not None:
                self._chunk = memoryview(chunk)
                return True
            self._queue.popleft()
        return False

    def _next_frame(self) -> bytes | None:
        if len(self._incoming) < FRAME_LENGTH.size:
            return None
        end = FRAME_LENGTH.size + FRAME_LENGTH.unpack_from(self._incoming)[0]
        if len(self._incoming) < end:
            return None
        frame = bytes(memoryview(self._incoming)[FRAME_LENGTH.size : end])
        self._incoming = self._incoming[end:]
        return frame


def encode_frame(payload: bytes) -> bytes:
    """Prefix a payload with its length."""
    return FRAME_LENGTH.pack(len(payload)) + payload


def reserve_stdout() -> int:
    """Return a descriptor of stdout for replies; what is printed goes to stderr from now on."""
    replies = os.dup(STDOUT)
    os.dup2(STDERR, STDOUT)
    return replies


def read_frame(stream: int) -> bytes | None:
    """Read a frame, blocking; None at the end of the stream."""
    if (head := _read_exactly(stream, FRAME_LENGTH.size)) is None:
        return None
    return _read_exactly(stream, FRAME_LENGTH.unpack(head)[0])


def write_frame(stream: int, payload: bytes) -> None:
    """Write a frame, blocking."""
    left = memoryview(encode_frame(payload))
    while left:
        left = left[os.write(stream, left) :]


def _read_exactly(stream: int, length: int) -> bytes | None:
    parts = []
    while length:
        part = os.read(stream, min(length, CHUNK_BYTES))
        if not part:
            return None
        parts.append(part)
        length -= len(part)
    return b"".join(parts)


def run_in_copy(task: Callable[[], bytes]) -> ProcessOutcome:
    """Run a task in a copy of this process, which ends with it and changes nothing in it.

    Where `CAN_COPY` is False it runs in this process.

    Raises:
        SystemExit: In the copy, when the task is over: its exit handlers run.
    """
    if not CAN_COPY:
        return ProcessOutcome(0, task())
    reader, writer = os.pipe()
    parent = os.getpid()
    child = os.fork()
    if child == 0:
        os.close(reader)
        die_with_parent(parent=parent)
        output = task()
        with os.fdopen(writer, "wb") as stream:
            stream.write(output)
        raise SystemExit
    os.close(writer)
    with os.fdopen(reader, "rb") as stream:
        output = stream.read()
    return ProcessOutcome(os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), output)


class ServingCopy:
    """A copy of this process that replies to requests, one after another; needs `CAN_COPY`."""

    def __init__(self, reply: Callable[[bytes], bytes]) -> None:
        """Copy this process; the copy ends with it, or when it is closed.

        Args:
            reply: Makes the reply to a request, in the copy.
        """
        requests, self._requests = os.pipe()
        self._replies, replies = os.pipe()
        parent = os.getpid()
        self._child = os.fork()
        if self._child == 0:
            os.close(self._requests)
            os.close(self._replies)
            die_with_parent(parent=parent)
            while (request := read_frame(requests)) is not None:
                write_frame(replies, reply(request))
            raise SystemExit
        os.close(requests)
        os.close(replies)

    @property
    def is_alive(self) -> bool:
        """Whether the copy has not ended yet; others may have killed it."""
        options = os.WEXITED | os.WNOHANG | os.WNOWAIT
        return os.waitid(os.P_PID, self._child, options) is None

    def call(self, request: bytes) -> ProcessOutcome:
        """Wait for the reply; with a status other than 0 the copy has ended instead."""
        with suppress(BrokenPipeError):
            write_frame(self._requests, request)
        if (reply := read_frame(self._replies)) is not None:
            return ProcessOutcome(0, reply)
        return ProcessOutcome(self.close() or NO_REPLY, b"")

    def close(self) -> int:
        """Let the copy end, and return its exit status, negative for a signal."""
        os.close(self._requests)
        os.close(self._replies)
        return os.waitstatus_to_exitcode(os.waitpid(self._child, 0)[1])


def run_in_fork(
    task: Callable[[Callable[[int], None]], None], report_timeout_s: float
) -> tuple[int | None, int]:
    """Run a task in a copy of this process, which nothing changes in this one.

    Args:
        task: Called with a function that reports a number (uint32) before each attempt.
        report_timeout_s: The copy is killed when nothing is reported for this long.

    Returns:
        The last number reported, None without any; the wait status, 0 when the task returned. Also
        None and 0 on Windows, which cannot copy a process: the task is not run.
    """
    if not hasattr(os, "fork"):
        return None, 0
    reader, writer = os.pipe()
    child = os.fork()
    if child == 0:
        os.close(reader)
        _run_forked(task, writer)
    os.close(writer)
    try:
        return _wait_for_fork(reader, child, report_timeout_s)
    finally:
        os.close(reader)


def _run_forked(task: Callable[[Callable[[int], None]], None], writer: int) -> NoReturn:
    def report(number: int) -> None:
        os.write(writer, FORK_REPORT.pack(number))

    status = 1
    try:
        task(report)
        status = 0
    finally:
        os._exit(status)


def _wait_for_fork(reader: int, child: int, report_timeout_s: float) -> tuple[int | None, int]:
    last: int | None = None
    while True:
        if not select.select([reader], [], [], report_timeout_s)[0]:
            os.kill(child, SIGKILL)
        if not (data := os.read(reader, FORK_REPORT.size)):
            break
        last = FORK_REPORT.unpack(data)[0]
    return last, os.waitpid(child, 0)[1]
