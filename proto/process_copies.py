"""Copies of a process that has imported all: each becomes a program, a child of who started it.

Ten interpreters that import the same take ten times its time and memory; ten copies share both.
"""

import ctypes
import os
import signal
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from zensim.proto.parent_death import PARENT_PID_VARIABLE, SIGKILL

STATUS: Final = Path("/proc/self/stat")
ARGUMENTS_START, ARGUMENTS_END = 45, 46
"""Fields of `STATUS` after the name in brackets."""
ADOPTION_POLL_S: Final = 0.001
STARTED: Final = b"+"
"""Sent to each copy once the process ids of all are known."""


class AdoptedProcess:
    """A child that this process got from one that has ended, without pipes."""

    stdin: None = None
    stdout: None = None

    def __init__(self, pid: int) -> None:
        self.pid = pid
        self.returncode: int | None = None

    def poll(self) -> int | None:
        """See `Process`."""
        if self.returncode is None:
            self._note(os.WNOHANG)
        return self.returncode

    def wait(self) -> int:
        """See `Process`."""
        while self.returncode is None:
            self._note(0)
        return self.returncode

    def terminate(self) -> None:
        """See `Process`."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """See `Process`."""
        self._send(SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        if self.poll() is None:
            os.kill(self.pid, number)

    def _note(self, options: int) -> None:
        try:
            found, status = os.waitpid(self.pid, options)
        except ChildProcessError:
            self.returncode = 0  # another part of the program has reaped it
            return
        if found:
            self.returncode = os.waitstatus_to_exitcode(status)


def copy_process(count: int, environ: Mapping[str, str]) -> int | None:
    """Make copies of this process, print their process ids, and end soon after.

    The copies belong to the process that `PARENT_PID_VARIABLE` names, once this one has ended: it
    must be a subreaper. They have sessions and standard outputs of their own.

    Returns:
        The number of the copy, from 0 on; None in the original.

    Raises:
        SystemExit: In a copy whose original or parent has failed.
    """
    reader, writer = os.pipe()
    original, pids = os.getpid(), []
    for number in range(count):
        if (pid := os.fork()) == 0:
            os.close(writer)
            _become_program(reader, original, environ)
            return number
        pids.append(pid)
    os.write(sys.stdout.fileno(), "".join(f"{pid}\n" for pid in pids).encode())
    os.write(writer, STARTED * count)
    return None


def _become_program(reader: int, original: int, environ: Mapping[str, str]) -> None:
    os.setsid()
    output = os.open(os.devnull, os.O_WRONLY)
    os.dup2(output, sys.stdout.fileno())
    os.close(output)
    if os.read(reader, 1) != STARTED:
        sys.exit(f"process {original} has ended before all of its copies were made")
    os.close(reader)
    while os.getppid() == original:
        time.sleep(ADOPTION_POLL_S)
    parent = environ.get(PARENT_PID_VARIABLE, "")
    if str(os.getppid()) != parent:
        sys.exit(f"parent process {parent} has ended, so this copy ends")


def name_process(words: Sequence[str]) -> None:
    """Show a command line of this process, where there is room for it in the former one."""
    fields = STATUS.read_text(encoding="utf-8", errors="replace").rpartition(")")[2].split()
    start, end = int(fields[ARGUMENTS_START]), int(fields[ARGUMENTS_END])
    line = b"\0".join(word.encode() for word in words) + b"\0"
    if 0 < start < end and len(line) <= end - start:
        ctypes.memmove(start, line.ljust(end - start, b"\0"), end - start)
