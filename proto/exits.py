"""Exit statuses of every command, and the one line that goes with a failure."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

from zensim.proto.bus import BusError, NoServer, Unreachable
from zensim.proto.codec import MalformedPayload
from zensim.proto.result import ResultCode, ServiceError


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
    """Choose the exit status for a failure; a `code` of NOT_FOUND decides where there is one."""
    if getattr(error, "code", None) == ResultCode.NOT_FOUND:
        return Exit.NOT_FOUND
    for kinds, status in _STATUSES:
        if isinstance(error, kinds):
            return status
    return Exit.FAILED


_STATUSES: tuple[tuple[tuple[type[Exception], ...], Exit], ...] = (
    ((NoServer, Unreachable), Exit.UNREACHABLE),
    ((TimeoutError,), Exit.TIMEOUT),
    ((FileNotFoundError,), Exit.NOT_FOUND),
    ((MalformedPayload,), Exit.FAILED),  # what somebody sent, not what was typed
    ((ValueError,), Exit.USAGE),
)


def line_of(error: Exception) -> str:
    """Say a failure in one line, with its code."""
    text = " ".join(str(error).split())
    if isinstance(error, ServiceError):
        return text
    if isinstance(error, OSError) and error.filename:
        text = f"{error.filename}: {error.strerror}"
    status = status_of(error)
    return f"{status.name} ({int(status)}): {text}"


@contextmanager
def one_line_failures(command: str, *also: type[Exception]) -> Iterator[None]:
    """End the command with one line on standard error and a status when something fails inside.

    Args:
        command: The verb, as the line names it.
        also: Failures to expect besides `FAILURES`.

    Raises:
        SystemExit: With one of `Exit`.
    """
    try:
        yield
    except BrokenPipeError:
        # The reader has gone, as `| head` does: nothing is wrong, and nothing more can be written.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(Exit.OK) from None
    except Exception as error:
        if not isinstance(error, (*FAILURES, *also)):
            raise
        sys.stderr.write(f"zensim {command}: {line_of(error)}\n")
        raise SystemExit(status_of(error)) from error
    except KeyboardInterrupt:
        raise SystemExit(Exit.INTERRUPTED) from None
