"""Exit codes of every command, and the one-line message printed with a failure."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum

from zensim.proto.messages.result_messages import ResultCode, ServiceError


class ExitCode(IntEnum):
    """Exit status of a command."""

    OK = 0
    FAILED = 1
    USAGE = 2
    NOT_FOUND = 3
    UNREACHABLE = 4
    TIMEOUT = 5
    PARTIAL = 6
    INTERRUPTED = 130


def list_expected_failures() -> tuple[type[Exception], ...]:
    """List the failures that a command reports in one line."""
    # Imported when something failed: commands without a network start faster.
    from zensim.proto.bus import BusError

    return (ServiceError, BusError, TimeoutError, ValueError, OSError)


def choose_exit_code(error: Exception) -> ExitCode:
    """Choose the exit status of a failure; a `code` of NOT_FOUND takes precedence."""
    if getattr(error, "code", None) == ResultCode.NOT_FOUND:
        return ExitCode.NOT_FOUND
    for kinds, status in _list_exit_codes():
        if isinstance(error, kinds):
            return status
    return ExitCode.FAILED


def _list_exit_codes() -> tuple[tuple[tuple[type[Exception], ...], ExitCode], ...]:
    from zensim.proto.bus import EndpointUnreachable, NoServer
    from zensim.proto.codec.message_codec import MalformedPayload

    return (
        ((NoServer, EndpointUnreachable), ExitCode.UNREACHABLE),
        ((TimeoutError,), ExitCode.TIMEOUT),
        ((FileNotFoundError,), ExitCode.NOT_FOUND),
        ((MalformedPayload,), ExitCode.FAILED),  # received, not typed
        ((ValueError,), ExitCode.USAGE),
    )


def format_failure(error: Exception) -> str:
    """Write a failure in one line, with its code."""
    text = " ".join(str(error).split())
    if isinstance(error, ServiceError):
        return text
    if isinstance(error, OSError) and error.filename:
        text = f"{error.filename}: {error.strerror}"
    status = choose_exit_code(error)
    return f"{status.name} ({int(status)}): {text}"


@contextmanager
def exit_on_failure(command: str, *also: type[Exception]) -> Iterator[None]:
    """Report a failure of the body in one line on standard error, and exit.

    Args:
        command: Name of the command in the line.
        also: Failures to report besides `list_expected_failures`; others propagate.

    Raises:
        SystemExit: With one of `ExitCode`.
    """
    try:
        yield
    except BrokenPipeError:
        # The reader closed the pipe, as `| head` does: not a failure, but stdout is unusable.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(ExitCode.OK) from None
    except Exception as error:
        if not isinstance(error, (*list_expected_failures(), *also)):
            raise
        sys.stderr.write(f"zensim {command}: {format_failure(error)}\n")
        raise SystemExit(choose_exit_code(error)) from error
    except KeyboardInterrupt:
        raise SystemExit(ExitCode.INTERRUPTED) from None
