"""Programs of zensim that begin as copies of a process which has imported everything.

A program is as real as one that the interpreter starts: a process with descriptors, environment,
session and exit status of its own. It only does not import for half a second of processor time,
which was a quarter of all tests. The interpreter starts what tests start otherwise.

`python -m tests.integration.fork_server FD` serves; `start_program` is its client.
"""

import atexit
import gc
import json
import os
import select
import selectors
import signal
import socket
import struct
import subprocess
import sys
import threading
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import IO

from tests.contract.repository import ROOT
from zensim.proto.parent_death import PARENT_PID_VARIABLE

PRELOADED = (
    *("zensim.deploy.cli", "zensim.deploy.cli.serve_commands", "zensim.sim_server.server"),
    *(
        "zensim.deploy.cli.agent_commands",
        "zensim.robot_agent.agent",
        "zensim.robot_agent.pool.pooled_robots",
    ),
)
MODULE = "tests.integration.fork_server"
PROGRAM = str(ROOT / "zensim" / "__main__.py")
MAX_REQUEST_BYTES = 1 << 20
NUMBER = struct.Struct("<i")
END = struct.Struct("<id")
"""Exit status of a program, and its processor seconds with those of its own child processes."""
STREAMS = 3


class ForkedProgram(subprocess.Popen[str]):
    """A program, with the methods of `subprocess.Popen`; the fork server is its parent."""

    def __init__(
        self, arguments: Sequence[str], pid: int, status: int, streams: Sequence[IO[str] | None]
    ) -> None:
        self.args = arguments
        self.pid = pid
        self.returncode: int | None = None
        self.stdin, self.stdout, self.stderr = streams
        self.text_mode = True
        self.encoding = self.errors = None
        self._status = status
        self._child_created = True
        self._communication_started = False
        self._input = None
        self._sigint_wait_secs = 0.25
        self._waitpid_lock = threading.Lock()

    def _internal_poll(self, _deadstate: int | None = None) -> int | None:
        return self._read_status(0.0)

    def _wait(self, timeout: float | None) -> int:
        status = self._read_status(timeout)
        if status is None:
            raise subprocess.TimeoutExpired(self.args, timeout or 0.0)
        return status

    def _read_status(self, timeout_s: float | None) -> int | None:
        with self._waitpid_lock:
            if self.returncode is None and select.select([self._status], [], [], timeout_s)[0]:
                packed = os.read(self._status, END.size)
                # The fork server is gone with all of its programs if nothing can be read.
                self.returncode, cpu_s = END.unpack(packed) if packed else (-signal.SIGKILL, 0.0)
                os.close(self._status)
                _ended_cpu_s.append(_ended_cpu_s.pop() + cpu_s)
            return self.returncode


class ForkServer:
    """The process that forks; it ends with this one."""

    def __init__(self) -> None:
        self._socket, theirs = socket.socketpair()
        self._lock = threading.Lock()
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", MODULE, str(theirs.fileno())],
                cwd=ROOT,
                env={**os.environ, PARENT_PID_VARIABLE: ""},
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
            )

    def start(
        self, arguments: Sequence[str], environment: Mapping[str, str], streams: Sequence[int]
    ) -> tuple[int, int]:
        """Start a program; return its process id, and a descriptor that gets its status."""
        status, theirs = os.pipe()
        request = json.dumps([list(arguments), dict(environment), str(Path.cwd())]).encode()
        with self._lock:
            self._socket.sendall(NUMBER.pack(len(request)))
            socket.send_fds(self._socket, [request[:1]], [*streams, theirs])
            self._socket.sendall(request[1:])
            os.close(theirs)
            (pid,) = NUMBER.unpack(self._socket.recv(NUMBER.size, socket.MSG_WAITALL))
        return pid, status

    def close(self) -> None:
        """End the server, and so its programs."""
        self._socket.close()
        self._process.wait()


_servers: dict[int, ForkServer] = {}
"""By process id: a process that tests fork has none of its own."""
_ended_cpu_s = [0.0]


def find_cpu_time_s() -> float:
    """Find the processor time of the programs that ended, which are no child processes."""
    return _ended_cpu_s[0]


def start_program(arguments: Sequence[str]) -> ForkedProgram:
    """Start `zensim ARGUMENTS` in a session of its own, with pipes for its output."""
    server = _find_server()
    (out, out_end), (err, err_end) = os.pipe(), os.pipe()
    null = os.open(os.devnull, os.O_RDONLY)
    try:
        pid, status = server.start(arguments, os.environ, (null, out_end, err_end))
    finally:
        for descriptor in (null, out_end, err_end):
            os.close(descriptor)
    streams = (None, open(out, encoding="utf-8"), open(err, encoding="utf-8"))  # noqa: PTH123, SIM115
    return ForkedProgram(["zensim", *arguments], pid, status, streams)


def run_program(arguments: Sequence[str], timeout_s: float) -> "subprocess.CompletedProcess[str]":
    """Run `zensim ARGUMENTS` to its end, as `subprocess.run` does.

    Raises:
        subprocess.TimeoutExpired: It did not end in time, and is killed.
    """
    with start_program(arguments) as program:
        try:
            out, err = program.communicate(timeout=timeout_s)
        finally:
            program.kill()
    return subprocess.CompletedProcess(program.args, program.wait(), out, err)


def _find_server() -> ForkServer:
    if (server := _servers.get(os.getpid())) is None:
        server = _servers[os.getpid()] = ForkServer()
        atexit.register(server.close)
    return server


class _Children:
    """Programs that run, and where their statuses go."""

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._selector = selectors.DefaultSelector()
        self._selector.register(connection, selectors.EVENT_READ, None)

    def serve(self) -> Sequence[str] | None:
        """Fork programs until the client is gone; return the arguments in a child."""
        while True:
            for key, _ in self._selector.select():
                if key.data is not None:
                    self._reap(key.fd, *key.data)
                    continue
                request = _receive(self._connection)
                if request is None:
                    return None
                if (arguments := self._fork(*request)) is not None:
                    return arguments

    def _fork(self, request: bytes, descriptors: Sequence[int]) -> Sequence[str] | None:
        *streams, status = descriptors
        if (pid := os.fork()) == 0:
            return self._become(request, streams, status)
        for descriptor in streams:
            os.close(descriptor)
        self._selector.register(os.pidfd_open(pid), selectors.EVENT_READ, (pid, status))
        self._connection.sendall(NUMBER.pack(pid))
        return None

    def _become(self, request: bytes, streams: Sequence[int], status: int) -> Sequence[str]:
        """Take over what a started program has from its parent."""
        for key in list(self._selector.get_map().values()):
            os.close(key.fd)
            if key.data is not None:
                os.close(key.data[1])
        self._selector.close()
        self._connection.detach()
        arguments, environment, folder = json.loads(request)
        for number, descriptor in enumerate(streams):
            os.dup2(descriptor, number)
        for descriptor in (*streams, status):
            os.close(descriptor)
        os.setsid()
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment, **{PARENT_PID_VARIABLE: str(os.getppid())})
        return list(arguments)

    def _reap(self, descriptor: int, pid: int, status: int) -> None:
        self._selector.unregister(descriptor)
        os.close(descriptor)
        _, code, usage = os.wait4(pid, 0)
        cpu_s = usage.ru_utime + usage.ru_stime
        os.write(status, END.pack(os.waitstatus_to_exitcode(code), cpu_s))
        os.close(status)


def _receive(connection: socket.socket) -> tuple[bytes, list[int]] | None:
    """Receive a request and its descriptors; None = the client is gone."""
    head = connection.recv(NUMBER.size, socket.MSG_WAITALL)
    if len(head) < NUMBER.size:
        return None
    (length,) = NUMBER.unpack(head)
    first, descriptors, _, _ = socket.recv_fds(connection, 1, STREAMS + 1)
    rest = connection.recv(length - 1, socket.MSG_WAITALL)
    return first + rest, descriptors


def _serve_client(descriptor: int) -> Sequence[str] | None:
    for module in PRELOADED:
        import_module(module)
    from zensim.sim_server.server import import_served_world  # noqa: PLC0415

    import_served_world()
    gc.freeze()
    return _Children(socket.socket(fileno=descriptor)).serve()


if __name__ == "__main__":
    given = _serve_client(int(sys.argv[1]))
    if given is not None:
        sys.argv = [PROGRAM, *given]
        import_module("zensim.deploy.cli").main()
