"""Exit status and error line of each kind of failure."""

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from zensim.proto.bus.bus_errors import BusError, EndpointTaken, EndpointUnreachable, NoServer
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.exit_codes import ExitCode, choose_exit_code, exit_on_failure, format_failure
from zensim.proto.messages.result_messages import ResultCode, ServiceError, SpawnCode
from zensim.proto.names import InvalidName
from zensim.proto.verbosity import CURRENT, set_verbosity
from zensim.sim_server.errors import EntityNotFound, NameNotUnique


def a_refusal(code: int, name: str = "SOME_CODE") -> ServiceError:
    return ServiceError("spawn_entity", code, name, "given, wrong, works")


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (a_refusal(ResultCode.NOT_FOUND), ExitCode.NOT_FOUND),
        (a_refusal(ResultCode.OPERATION_FAILED), ExitCode.FAILED),
        (a_refusal(SpawnCode.NAME_NOT_UNIQUE), ExitCode.FAILED),
        (NoServer("none"), ExitCode.UNREACHABLE),
        (EndpointUnreachable("none"), ExitCode.UNREACHABLE),
        (EndpointTaken("taken"), ExitCode.FAILED),
        (BusError("odd"), ExitCode.FAILED),
        (TimeoutError("late"), ExitCode.TIMEOUT),
        (FileNotFoundError(2, "no such file", "a.urdf"), ExitCode.NOT_FOUND),
        (PermissionError(13, "denied", "a.urdf"), ExitCode.FAILED),
        (IsADirectoryError(21, "is a directory", "a"), ExitCode.FAILED),
        (InvalidName("no name"), ExitCode.USAGE),
        (ValueError("no number"), ExitCode.USAGE),
        (MalformedPayload("no message"), ExitCode.FAILED),
        (KeyError("else"), ExitCode.FAILED),
    ],
    ids=lambda value: type(value).__name__,
)
def test_failure_has_its_exit_status(error: Exception, status: ExitCode) -> None:
    assert choose_exit_code(error) == status


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (a_refusal(101, "NAME_NOT_UNIQUE"), "given, wrong, works"),
        (NoServer("no server"), "no server"),
        (FileNotFoundError(2, "no such file", "a.urdf"), "a.urdf: no such file"),
        (ValueError("first\n  second\tthird"), "first second third"),
    ],
    ids=lambda value: type(value).__name__,
)
def test_failure_is_one_line_without_numbers(error: Exception, line: str) -> None:
    assert format_failure(error) == line


def test_command_ends_with_one_line_and_a_status(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, exit_on_failure("spawn"):
        raise NoServer("no server")

    printed = capsys.readouterr()
    assert ended.value.code == ExitCode.UNREACHABLE
    assert printed.err == "zensim spawn: no server\n"
    assert printed.out == ""


def test_command_reports_further_failures_that_it_declares(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as ended, exit_on_failure("up", LookupError):
        raise LookupError("lost")

    assert ended.value.code == ExitCode.FAILED
    assert capsys.readouterr().err == "zensim up: lost\n"


@pytest.fixture
def usual_verbosity() -> Iterator[None]:
    yield
    set_verbosity(is_quiet=False, is_verbose=False, is_json=False)


@pytest.mark.usefixtures("usual_verbosity")
def test_failure_of_a_command_with_json_has_code_and_number(
    capsys: pytest.CaptureFixture[str],
) -> None:
    set_verbosity(is_quiet=False, is_verbose=False, is_json=True)

    with pytest.raises(SystemExit), exit_on_failure("spawn"):
        raise a_refusal(101, "NAME_NOT_UNIQUE")

    assert json.loads(capsys.readouterr().err) == {
        "error": {
            "command": "spawn",
            "code": "NAME_NOT_UNIQUE",
            "number": 101,
            "message": "given, wrong, works",
        }
    }


@pytest.mark.usefixtures("usual_verbosity")
def test_verbose_command_prints_where_its_failure_came_from(
    capsys: pytest.CaptureFixture[str],
) -> None:
    set_verbosity(is_quiet=False, is_verbose=True, is_json=False)

    with pytest.raises(SystemExit), exit_on_failure("spawn"):
        raise NoServer("no server")

    assert "Traceback" in capsys.readouterr().err


@pytest.mark.parametrize("message", [str(NameNotUnique("r1")), str(EntityNotFound("r9"))])
def test_refusals_of_services_name_commands(message: str) -> None:
    text = format_failure(ServiceError("spawn_entity", 101, "SOME_CODE", message))

    assert "allow_renaming" not in text.replace("--allow-renaming", "")
    assert "get_entities" not in text
    assert text != message


def test_a_missing_folder_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError) as caught:
        (tmp_path / "no" / "file.mcap").open("wb")

    assert str(tmp_path / "no") + "\n" in format_failure(caught.value) + "\n"


def test_unexpected_error_propagates() -> None:
    with pytest.raises(ZeroDivisionError), exit_on_failure("spawn"):
        raise ZeroDivisionError


def test_command_prints_nothing_when_nothing_fails(capsys: pytest.CaptureFixture[str]) -> None:
    with exit_on_failure("spawn"):
        pass

    assert capsys.readouterr().err == ""


def test_command_ends_quietly_when_interrupted(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as ended, exit_on_failure("drive"):
        raise KeyboardInterrupt

    assert ended.value.code == ExitCode.INTERRUPTED
    assert capsys.readouterr().err == ""


def test_command_exits_with_ok_on_a_broken_pipe() -> None:
    program = (
        "from zensim.proto.exit_codes import exit_on_failure\n"
        "import sys\n"
        "with exit_on_failure('echo'):\n"
        "    while True:\n"
        "        print('line', flush=True)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
    )
    assert process.stdout is not None
    process.stdout.readline()

    process.stdout.close()
    _, complaint = process.communicate(timeout=120.0)

    assert (process.returncode, complaint) == (ExitCode.OK, b"")


def test_setting_of_a_message_is_written_as_an_option_of_the_command(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(CURRENT, "options", {"step_hz": "--step-hz"})

    text = format_failure(ValueError("`step_hz` 0 is out of range; see `other` and `zensim up`"))

    assert text == "--step-hz 0 is out of range; see `other` and `zensim up`"
