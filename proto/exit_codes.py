"""Exit codes of every command, and the one-line message printed with a failure."""

import json
import os
import re
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from enum import IntEnum
from pathlib import Path

from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.printable_text import print_lines
from zensim.proto.verbosity import CURRENT


class ExitCode(IntEnum):
    """Exit status of a command."""

    OK = 0
    FAILED = 1
    USAGE = 2
    NOT_FOUND = 3
    UNREACHABLE = 4
    TIMEOUT = 5
    PARTIAL = 6
    NOT_RECORDED = 7
    INTERRUPTED = 130


def list_expected_failures() -> tuple[type[Exception], ...]:
    """List the failures that a command reports in one line."""
    # Imported when something failed: commands without a network start faster.
    from zensim.proto.bus.bus_errors import BusError

    return (ServiceError, BusError, TimeoutError, ValueError, OSError)


def choose_exit_code(error: Exception) -> ExitCode:
    """Choose the exit status of a failure: its own, NOT_FOUND by its `code`, or by its class."""
    if isinstance(status := getattr(error, "exit_code", None), ExitCode):
        return status
    if getattr(error, "code", None) == ResultCode.NOT_FOUND:
        return ExitCode.NOT_FOUND
    for kinds, status in _list_exit_codes():
        if isinstance(error, kinds):
            return status
    return ExitCode.FAILED


def _list_exit_codes() -> tuple[tuple[tuple[type[Exception], ...], ExitCode], ...]:
    from zensim.proto.bus.bus_errors import EndpointUnreachable, NoServer
    from zensim.proto.codec.message_codec import MalformedPayload

    return (
        ((NoServer, EndpointUnreachable), ExitCode.UNREACHABLE),
        ((TimeoutError,), ExitCode.TIMEOUT),
        ((FileNotFoundError,), ExitCode.NOT_FOUND),
        ((MalformedPayload,), ExitCode.FAILED),  # received, not typed
        ((ValueError,), ExitCode.USAGE),
    )


CLI_WORDS = {
    "set allow_renaming": "use --allow-renaming",
    "'?get_entities'?": "'zensim list'",
    "get_available_worlds": "'zensim world list'",
    "unload_world and load_world": "'zensim world unload' and 'zensim world load'",
    "load_world": "'zensim world load'",
    "send the text as resource_string": "give the path of a file",
}
"""What commands call what messages of services name, as regular expressions; in this order."""


SETTING = re.compile(r"`([a-z][a-z0-9_]*)`")


def to_cli_words(message: str) -> str:
    """Write the message of a service in the words of commands, without the code before it."""
    text = re.sub(r"^[A-Z_]+ \(\d+\): ", "", message)
    for theirs, ours in CLI_WORDS.items():
        text = re.sub(theirs, ours, text)
    return text


def format_failure(error: Exception) -> str:
    """Write a failure in one line, in the words of the command line.

    The exit status has the number of a command's failure; `--json` prints the code of a service.
    """
    if isinstance(error, ServiceError):
        text = to_cli_words(error.message)
    elif isinstance(error, OSError) and error.filename:
        text = f"{error.filename}: {error.strerror}"
        folder = Path(os.fsdecode(error.filename)).parent
        if isinstance(error, FileNotFoundError) and not folder.is_dir():
            text = f"{error.filename}: there is no folder {folder}"
    else:
        text = str(error)
    return " ".join(SETTING.sub(_spell_setting, text).split())


def _spell_setting(found: re.Match[str]) -> str:
    """Write a setting that a message names in backticks as the option of the running command."""
    return CURRENT.options.get(found[1], found[0])


def print_failure(command: str, error: Exception) -> None:
    """Print a failure in one line on standard error; as JSON where the command prints JSON."""
    if CURRENT.is_verbose:
        traceback.print_exception(error)
    text = format_failure(error)
    if not CURRENT.is_json:
        print_lines(f"zensim {command}: {text}", err=True)
        return
    code = error.code_name if isinstance(error, ServiceError) else choose_exit_code(error).name
    number = error.code if isinstance(error, ServiceError) else int(choose_exit_code(error))
    failure = {"command": command, "code": code, "number": number, "message": text}
    print_lines(json.dumps({"error": failure}), err=True)


@contextmanager
def exit_on_closed_pipe() -> Iterator[None]:
    """Exit with status 0 when the reader of the output has closed it, as `| head` does.

    Raises:
        SystemExit: It has.
    """
    try:
        yield
    except BrokenPipeError:
        # Standard output is unusable, and the interpreter flushes it at its end.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise SystemExit(ExitCode.OK) from None


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
        with exit_on_closed_pipe():
            yield
    except Exception as error:
        if not isinstance(error, (*list_expected_failures(), *also)):
            raise
        print_failure(command, error)
        raise SystemExit(choose_exit_code(error)) from error
    except KeyboardInterrupt:
        raise SystemExit(ExitCode.INTERRUPTED) from None
