"""`zensim test`: run scenario files and report their checks."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import msgspec
import typer

from zensim.deploy.cli.command_session import print_json
from zensim.deploy.cli.scenario_commands import (
    FilesArgument,
    PythonOption,
    RunTimeoutOption,
    collect_issues,
)
from zensim.deploy.scenario_process import RunRequest, run_all
from zensim.deploy.scenario_report import format_markdown, format_run, to_json, to_junit
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.options.command_options import JsonOption, SetOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.scenario.scenario_nodes import Issue
from zensim.scenario.scenario_reader import SUFFIXES, Scenario, find_scenario_file, read_scenario
from zensim.scenario.scenario_runner import RunReport
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

app = make_app()

_output = partial(typer.Option, metavar="FILE", rich_help_panel="Output", dir_okay=False)


@dataclass(frozen=True, kw_only=True)
class ScenarioTestOptions:
    """All options of `zensim test`."""

    __test__ = False

    files: FilesArgument
    settings: SetOption = None
    select: Annotated[
        str, typer.Option("-k", metavar="TEXT", help="Only scenarios with this in their name.")
    ] = ""
    jobs: Annotated[
        int, typer.Option("--jobs", "-j", min=1, metavar="N", help="Number of runs at once.")
    ] = 1
    repeat: Annotated[
        int,
        typer.Option(
            "--repeat", min=1, metavar="N", help="Runs of each; unequal states are a failure."
        ),
    ] = 1
    served: Annotated[
        bool, typer.Option("--server/--in-process", metavar="", help="Run on a server of its own.")
    ] = False
    python: PythonOption = True
    timeout: RunTimeoutOption = None
    junit: Annotated[Path | None, _output("--junit", help="File to write JUnit XML to.")] = None
    markdown: Annotated[
        Path | None, _output("--markdown", help="File to write a Markdown table to.")
    ] = None
    is_quiet: Annotated[bool, flag("--quiet", "-q", help="Print failures only.")] = False
    as_json: JsonOption = False


@app.command(
    name="test",
    epilog="""Examples:
  zensim test run.scenario.yaml
  zensim test scenarios --jobs 2 --junit report.xml
  zensim test first_minutes --set robots.bot.count=4 --repeat 2""",
)
def test_scenarios(given: ScenarioTestOptions) -> None:
    """Run scenario files as fast as possible, and print the margin of each check.

    Exit status: 0 if every run passed, 1 if one did not, 2 if a file has mistakes.
    """
    with exit_on_failure("test", MissingServerExtra):
        with server_extra():
            from zensim.sim_server.description import strict_xml  # noqa: F401  # for runs
        scenarios = _read_all([*_find_files(given.files)], given)
        requests = [_make_request(one, given) for one in scenarios for _ in range(given.repeat)]
        done: list[RunReport] = []
        try:
            run_all(requests, jobs=given.jobs, on_run=_show(done, given))
        finally:
            # What has ended is kept when the rest is interrupted.
            runs = _compare_repeats(done, given)
            _write_files(runs, given)
    if not all(run.is_passed for run in runs):
        raise typer.Exit(ExitCode.FAILED)


def _find_files(words: Sequence[str]) -> Iterator[str]:
    for word in words:
        if not Path(word).is_dir():
            yield find_scenario_file(word)
            continue
        found = sorted(str(file) for suffix in SUFFIXES for file in Path(word).rglob(f"*{suffix}"))
        if not found:
            raise FileNotFoundError(2, f"no file *{SUFFIXES[0]}", word)
        yield from found


def _read_all(files: Sequence[str], given: ScenarioTestOptions) -> list[Scenario]:
    """Read all files before the first run; print all mistakes of all."""
    scenarios: list[Scenario] = []
    issues: list[Issue] = []
    for file in files:
        with collect_issues(issues):
            scenarios.append(read_scenario(file, given.settings or ()))
    if issues:
        for issue in issues:
            print_lines(str(issue), err=True)
        raise typer.Exit(ExitCode.USAGE)
    chosen = [one for one in scenarios if given.select in one.name]
    if not chosen:
        raise ValueError(
            f"no scenario has {given.select!r} in its name; see the names of the files"
        )
    return chosen


def _make_request(scenario: Scenario, given: ScenarioTestOptions) -> RunRequest:
    limit = scenario.format.end.timeout if given.timeout is None else given.timeout
    return RunRequest(
        scenario.file,
        tuple(given.settings or ()),
        allows_python=given.python,
        is_served=given.served,
        timeout_s=limit,
        has_own_timeout=given.timeout is not None,
    )


def _show(done: list[RunReport], given: ScenarioTestOptions) -> Callable[[RunReport], None]:
    def show(run: RunReport) -> None:
        done.append(run)
        if not given.as_json and not (given.is_quiet and run.is_passed):
            print_lines("\n".join(format_run(run)))

    return show


def _compare_repeats(runs: Sequence[RunReport], given: ScenarioTestOptions) -> list[RunReport]:
    """Fail the runs of a scenario that ended in unequal states."""
    if (count := given.repeat) == 1:
        return list(runs)
    found: list[RunReport] = []
    for start in range(0, len(runs), count):
        own = runs[start : start + count]
        hashes = {run.state_hash for run in own}
        if len(hashes) > 1:
            failure = f"not deterministic: {len(own)} runs ended in {len(hashes)} states"
            if not given.as_json:
                print_lines(f"{own[0].name}: {failure}")
            own = [msgspec.structs.replace(run, error=run.error or failure) for run in own]
        found += own
    return found


def _write_files(runs: Sequence[RunReport], given: ScenarioTestOptions) -> None:
    if given.junit is not None:
        given.junit.write_bytes(to_junit(runs))
    if given.as_json:
        print_json(to_json(runs))
    if given.markdown is not None:
        given.markdown.write_text(format_markdown(runs), encoding="utf-8")
