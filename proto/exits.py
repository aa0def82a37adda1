"""Exit statuses of every command, and the one line that goes with a failure."""

from enum import IntEnum

from proto.bus import BusError, NoServer, Unreachable
from proto.result import ResultCode, ServiceError


class Exit(IntEnum):
    """How a command ended."""

    OK = 0
    FAILED = 1
    USAGE = 2
    NOT_FOUND = 3
    UNREACHABLE = 4
    TIMEOUT = 5
    PARTIAL = 6
    INTERRUPTED = 130


FAILURES = (ServiceError, BusError, TimeoutError, ValueError, OSError)
"""What a command may run into and ends with one line for."""


def status_of(error: Exception) -> Exit:
    """Choose the exit status for a failure."""
    if isinstance(error, ServiceError):
        return Exit.NOT_FOUND if error.code == ResultCode.NOT_FOUND else Exit.FAILED
    if isinstance(error, (NoServer, Unreachable)):
        return Exit.UNREACHABLE
    if isinstance(error, TimeoutError):
        return Exit.TIMEOUT
    if isinstance(error, FileNotFoundError):
        return Exit.NOT_FOUND
    if isinstance(error, ValueError):
        return Exit.USAGE
    return Exit.FAILED


def line_of(error: Exception) -> str:
    """Say a failure in one line, with its code."""
    text = " ".join(str(error).split())
    if isinstance(error, ServiceError):
        return text
    if isinstance(error, OSError) and error.filename:
        return f"{error.filename}: {error.strerror}"
    names = {Exit.UNREACHABLE: "UNREACHABLE", Exit.TIMEOUT: "TIMEOUT", Exit.USAGE: "USAGE"}
    status = status_of(error)
    return f"{names.get(status, 'FAILED')} ({int(status)}): {text}"
