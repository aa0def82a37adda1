"""Run commands in this process, with their output and exit status."""

import json
from typing import Any

import typer
from typer.testing import CliRunner

from tests.integration.processes import Server
from zensim.proto.exit_codes import ExitCode

NOWHERE = "tcp/127.0.0.1:1"
RUNNER = CliRunner()


class Result:
    """Output and exit status of a finished command."""

    def __init__(self, app: typer.Typer, arguments: tuple[str, ...]) -> None:
        done = RUNNER.invoke(app, list(arguments), env={"COLUMNS": "200"})
        if done.exception is not None and not isinstance(done.exception, SystemExit):
            raise done.exception
        self.status = ExitCode(done.exit_code)
        self.out = done.stdout
        self.err = done.stderr

    def json(self) -> Any:  # noqa: ANN401  whatever the command printed
        return json.loads(self.out)


def run(app: typer.Typer, *arguments: str) -> Result:
    """Run a command; raise its unexpected exceptions."""
    return Result(app, arguments)


def run_at(server: Server, app: typer.Typer, *arguments: str) -> Result:
    """Run a command against a server."""
    return run(app, *arguments, "--connect", server.endpoint)


def assert_failed(done: Result, status: ExitCode, start: str, *values: str) -> None:
    """Check the exit status, and one error line, besides notes, that contains values."""
    assert (done.status, done.out) == (status, "")
    assert done.err.startswith(start), done.err
    assert sum(": note: " not in line for line in done.err.splitlines()) == 1
    assert all(value in done.err for value in values), done.err
