"""`zensim scenario`: check scenario files, print their JSON Schema, list the shipped ones."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated

import typer

from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.options.command_options import JsonOption, SetOption
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.verbosity import CURRENT
from zensim.scenario.scenario_nodes import Issue, ScenarioInvalid
from zensim.scenario.scenario_reader import (
    SHIPPED,
    SUFFIXES,
    Scenario,
    find_scenario_file,
    list_shipped_scenarios,
    read_scenario,
)
from zensim.scenario.scenario_schema import format_schema
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

app = make_app("scenario")

FilesArgument = Annotated[
    list[str],
    typer.Argument(metavar="FILE...", help="Scenario files, or names of shipped scenarios."),
]
PythonOption = Annotated[
    bool, typer.Option("--python/--no-python", metavar="", help="Allow code of the file's author.")
]
RunTimeoutOption = Annotated[
    float | None,
    typer.Option("--timeout", min=0.1, metavar="SECONDS", help=r"Wall time of each run \[s]."),
]


@dataclass(frozen=True, kw_only=True)
class ScenarioCheckOptions:
    """All options of `zensim scenario check`."""

    files: FilesArgument
    settings: SetOption = None
    models: Annotated[
        bool,
        typer.Option(
            "--models/--no-models", metavar="", help="Read the world and the models, too."
        ),
    ] = True
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim scenario check run.scenario.yaml
  zensim scenario check run.scenario.yaml --set robots.cart.count=8"""
)
def check(given: ScenarioCheckOptions) -> None:
    """Read scenario files and print every mistake with file, line and column.

    Exit status: 0 without mistakes, 2 with some, 3 if a file does not exist.
    """
    with exit_on_failure("scenario check", MissingServerExtra):
        issues: list[Issue] = []
        for file in map(find_scenario_file, given.files):
            with collect_issues(issues):
                scenario = read_scenario(file, given.settings or ())
                issues += _check_models(scenario) if given.models else ()
    if given.as_json:
        print_lines(json.dumps([_to_json(issue) for issue in issues]))
    for issue in () if given.as_json else issues:
        print_lines(str(issue))
    if issues:
        raise typer.Exit(ExitCode.USAGE)
    if not given.as_json:
        print_lines(f"{len(given.files)} checked, no mistakes", err=True)


def _check_models(scenario: Scenario) -> tuple[Issue, ...]:
    with server_extra():
        from zensim.scenario.model_dry_run import check_models
    return check_models(scenario)


@contextmanager
def collect_issues(issues: list[Issue]) -> Iterator[None]:
    """Add the mistakes of the file that the body reads."""
    try:
        yield
    except ScenarioInvalid as error:
        issues += error.issues


def _to_json(issue: Issue) -> dict[str, object]:
    place = issue.place
    return {
        "file": place.file,
        "line": place.line,
        "column": place.column,
        "path": issue.path,
        "message": issue.message,
    }


@app.command()
def schema(*, as_json: JsonOption = False) -> None:
    """Print the JSON Schema of scenario files, for editors; with --json in one line."""
    text = format_schema()
    print_lines(json.dumps(json.loads(text)) if as_json else text.rstrip())


@app.command(name="list")
def list_shipped(*, as_json: JsonOption = False) -> None:
    """List the shipped scenarios with their files."""
    files = {name: str(SHIPPED / name) + SUFFIXES[0] for name in list_shipped_scenarios()}
    if as_json:
        print_lines(json.dumps([{"name": name, "file": file} for name, file in files.items()]))
        return
    for name, file in files.items():
        print_lines(name if CURRENT.is_quiet else f"{name}  {file}")
