"""`zensim check`: spawn and drive the robots of a folder, and print what they do."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import count
from pathlib import Path
from typing import Annotated, get_args

import msgspec
import typer

from zensim.deploy.check_report import format_markdown, format_table, to_json, to_junit
from zensim.deploy.cli.spawn_arguments import (
    DescriptionOptions,
    DynamicsOption,
    make_search_paths,
    parse_compat,
    parse_dynamics,
)
from zensim.deploy.robot_checks import (
    PASSED,
    CheckRow,
    RobotCheck,
    TrialRequest,
    find_robots,
    run_checks,
    run_trial_process,
)
from zensim.proto.drive_orders import parse_drive_order
from zensim.proto.engine_proofs import EngineName
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.options.command_options import AllowFailedEngineOption, JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.settings.engine_settings import EngineChoice
from zensim.sim_server.physics.engine_config import parse_engine_name
from zensim.sim_server.physics.engine_proof.engine_prover import choose_proven_engine
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

app = make_app()

BOTH = "both"
_check = partial(typer.Option, rich_help_panel="Check")
_output = partial(typer.Option, metavar="FILE", rich_help_panel="Output", dir_okay=False)


@dataclass(frozen=True, kw_only=True)
class CheckOptions(DescriptionOptions):
    """All options of `zensim check`."""

    paths: Annotated[
        list[Path],
        typer.Argument(
            metavar="PATH...",
            help="URDF, xacro and SDF files, folders to search, and lists of robots (.json).",
        ),
    ]
    engine: Annotated[
        str,
        _check(
            "--engine",
            metavar="pybullet|mujoco|both",
            help="Physics engine of the trials.",
            show_default="pybullet if installed",
            envvar="ZENSIM_ENGINE",
        ),
    ] = ""
    allow_failed_engine: AllowFailedEngineOption = False
    dynamics: DynamicsOption = "full"
    exclude: Annotated[
        list[str] | None,
        _check("--exclude", metavar="PATTERN", help="Paths to leave out; repeatable."),
    ] = None
    jobs: Annotated[
        int, _check("--jobs", "-j", min=1, metavar="N", help="Number of trials at once.")
    ] = 1
    trial_timeout: Annotated[
        float,
        _check(
            "--trial-timeout",
            min=0.001,
            metavar="SECONDS",
            help=r"Limit of the wall time of one trial \[s].",
        ),
    ] = 120.0
    tolerance: Annotated[
        float,
        _check(
            "--tolerance",
            min=0.001,
            max=1.0,
            metavar="SHARE",
            help="Largest deviation from the commanded speed and turn.",
        ),
    ] = 0.05
    accept_predicted: Annotated[
        bool,
        flag(
            "--accept-predicted",
            help="Exit with 0 also if a robot deviates as friction and geometry predict.",
            rich_help_panel="Check",
        ),
    ] = False
    as_json: JsonOption = False
    as_markdown: Annotated[
        bool, flag("--markdown", help="Print a Markdown table.", rich_help_panel="Output")
    ] = False
    junit: Annotated[Path | None, _output("--junit", help="File to write JUnit XML to.")] = None


@app.command(
    epilog="""Examples:
  zensim check ~/ws/src --exclude '*/test'
  zensim check robot.urdf.xacro --xacro-arg sim:=true --engine both
  zensim check robots.json --junit check.xml"""
)
def check(given: CheckOptions) -> None:
    """Spawn each robot alone, let it settle, drive it straight and turning, and print a table.

    Exit status: 0 if each robot drives as commanded or has nothing to drive, 1 if one does not, 3
    if there is none.
    """
    with exit_on_failure("check", MissingServerExtra):
        with server_extra():
            from zensim.sim_server.description import strict_xml  # noqa: F401  # for trials
            from zensim.sim_server.description.urdf import independent_reading
        requests = _make_requests(given)
        if not independent_reading.has_other_reader():
            print_lines(f"zensim check: {independent_reading.NOT_INSTALLED}", err=True)
        total = len(requests)

        done = count(1)

        def show(row: CheckRow) -> None:
            print_lines(f"{next(done)}/{total} {row.name} ({row.engine}): {row.verdict}", err=True)

        rows = run_checks(
            requests,
            partial(run_trial_process, timeout_s=given.trial_timeout),
            jobs=given.jobs,
            tolerance=given.tolerance,
            on_row=show,
        )
        if given.junit is not None:
            given.junit.write_bytes(to_junit(rows))
        _print_rows(rows, given)
    accepted = (*PASSED, "predicted") if given.accept_predicted else PASSED
    if not all(row.verdict in accepted for row in rows):
        raise typer.Exit(ExitCode.FAILED)


def _make_requests(given: CheckOptions) -> list[TrialRequest]:
    compat, engines = parse_compat(given), _choose_engines(given)
    dynamics = parse_dynamics(given.dynamics)
    # An order that cannot be parsed is a fault of the command, not of each robot.
    parse_drive_order(given.drive)
    paths = make_search_paths(given)
    robots = find_robots(given.paths, given.exclude or ())
    if not robots:
        raise FileNotFoundError(
            2, "no URDF, xacro or SDF file with a robot", " ".join(map(str, given.paths))
        )
    common = tuple(map(str, paths.roots))
    return [
        TrialRequest(
            robot=_add_options(robot, given, common),
            engine=engine,
            allow_missing=given.allow_missing,
            compat=compat,
            dynamics=dynamics,
            allow_failed_engine=given.allow_failed_engine,
        )
        for robot in robots
        for engine in engines
    ]


def _add_options(robot: RobotCheck, given: DescriptionOptions, roots: Sequence[str]) -> RobotCheck:
    """Add the options of the command line; those of the list come first."""
    return msgspec.structs.replace(
        robot,
        xacro_args=(*(given.xacro_arg or ()), *robot.xacro_args),
        package_paths=(*robot.package_paths, *roots),
        controllers=robot.controllers or tuple(map(str, given.controllers or ())),
        drive=robot.drive or given.drive,
    )


def _choose_engines(given: CheckOptions) -> list[str]:
    is_both = given.engine == BOTH
    names = get_args(EngineName) if is_both else (parse_engine_name(given.engine),)
    allowed = given.allow_failed_engine
    return [
        choose_proven_engine(EngineChoice(engine=name, allow_failed_engine=allowed))
        for name in names
    ]


def _print_rows(rows: Sequence[CheckRow], given: CheckOptions) -> None:
    if given.as_json:
        print_lines(json.dumps(to_json(rows)))
    elif given.as_markdown:
        print_lines(format_markdown(rows), nl=False)
    else:
        print_lines("\n".join(format_table(rows)))
