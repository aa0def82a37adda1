"""Commands run in this process, with what they said and how they ended."""

import json
from typing import Any

import typer
from typer.testing import CliRunner

from tests.integration.processes import Server
from zensim.proto.exit_codes import ExitCode

NOWHERE = "tcp/127.0.0.1:1"
RUNNER = CliRunner()


class Done:
    """A command that has ended."""

    def __init__(self, app: typer.Typer, arguments: tuple[str, ...]) -> None:
        result = RUNNER.invoke(app, list(arguments), env={"COLUMNS": "200"})
        if result.exception is not None and not isinstance(result.exception, SystemExit):
            raise result.exception
        self.status = ExitCode(result.exit_code)
        self.out = result.stdout
        self.err = result.stderr

    def json(self) -> Any:  # noqa: ANN401  whatever the command printed
        return json.loads(self.out)


def run(app: typer.Typer, *arguments: str) -> Done:
    """Run a command; a fault of its own is raised."""
    return Done(app, arguments)


def run_at(server: Server, app: typer.Typer, *arguments: str) -> Done:
    """Run a command against a server."""
    return run(app, *arguments, "--connect", server.endpoint)


def assert_failed(done: Done, status: ExitCode, line: str) -> None:
    """Check that a command ended with a status and one line that begins so."""
    assert (done.status, done.out) == (status, "")
    assert done.err.startswith(line), done.err
    assert done.err.count("\n") == 1
