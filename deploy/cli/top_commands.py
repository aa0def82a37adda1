"""`zensim top`: robots and processes of a world, with rates, CPU time and memory."""

import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Annotated

import msgspec
import typer
from rich.table import Table
from rich.text import Text

from zensim.deploy.cli.command_session import data_console, open_client, print_json, print_table
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.options.command_options import ClientOptions, JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines, printable
from zensim.proto.verbosity import CURRENT
from zensim.spawner.top.fleet_figures import (
    PROCESS_TITLES,
    ROBOT_TITLES,
    FleetReading,
    RobotRow,
    Row,
    filter_rows,
    format_value,
    list_process_rows,
    list_robot_rows,
    sort_rows,
    write_summary,
)
from zensim.spawner.top.fleet_source import FleetSource

app = make_app()

REPORT_S = 1.2
"""Each process reports once a second."""
START_S = 5.0
"""A server that reports nothing for so long publishes no statistics."""
POLL_S = 0.05


class MissingTopExtra(Exception):
    """The packages of the top extra are not installed."""


@dataclass(frozen=True, kw_only=True)
class TopOptions(ClientOptions):
    """All options of `zensim top`."""

    once: Annotated[bool, flag("--once", help="Measure once, print tables, and end.")] = False
    every: Annotated[
        float, typer.Option("--every", min=0.2, max=60.0, metavar="SECONDS", help=r"Period \[s].")
    ] = 1.0
    text: Annotated[
        str,
        typer.Option(
            "--filter",
            metavar="TEXT",
            help="Only robots with this text in name, model, drive or agent.",
        ),
    ] = ""
    sort: Annotated[
        str,
        typer.Option(
            "--sort", metavar="COLUMN", help=f"With --once: {', '.join(ROBOT_TITLES)} of robots."
        ),
    ] = "name"
    rates: Annotated[
        int,
        typer.Option(
            "--rates",
            min=0,
            metavar="N",
            help="Measure the odometry of at most N robots that are shown; 0 = of none.",
        ),
    ] = 30
    as_json: JsonOption = False


@app.command(
    epilog="""Examples:
  zensim top
  zensim top --once --filter r1
  zensim top --json | jq '.processes[] | {name, cpu}'"""
)
def top(given: TopOptions) -> None:
    """Show robots and processes of a world: rates, real-time factor, CPU time and memory."""
    with open_client("top", given) as client, exit_on_failure("top", MissingTopExtra):
        if given.sort not in ROBOT_TITLES:
            known = ", ".join(ROBOT_TITLES)
            raise ValueError(f"--sort must be one of {known}; got {given.sort[:40]!r}")
        is_screen = not (given.once or given.as_json) and data_console.is_terminal
        if is_screen and find_spec("textual") is None:
            raise MissingTopExtra(
                "textual is not installed; use pip install 'zensim[top]', or --once"
            )
        client.info()
        with closing(FleetSource(client)) as source:
            if is_screen:
                _run_screen(source, given)
            else:
                _print_once(source, given)


def _run_screen(source: FleetSource, given: TopOptions) -> None:
    from zensim.spawner.top.top_app import TopApp

    TopApp(source, period_s=given.every, max_rates=given.rates, filter_text=given.text).run()


def _print_once(source: FleetSource, given: TopOptions) -> None:
    first, last = _measure(source, given)
    processes = list_process_rows(last, first)
    robots = _choose_robots(last, given)
    if given.as_json:
        facts = {"server": last.stats, "processes": processes, "robots": robots}
        print_json(facts)
        return
    if CURRENT.is_quiet:
        print_lines("\n".join(row.name for row in robots))
        return
    print_lines(write_summary(last))
    print_table(_make_table(PROCESS_TITLES, processes))
    print_table(_make_table(ROBOT_TITLES, robots))


def _measure(source: FleetSource, given: TopOptions) -> tuple[FleetReading, FleetReading]:
    """Take two readings, with a report of the server in each.

    Raises:
        NoServer: It reports nothing.
    """
    deadline_s = time.monotonic() + START_S
    while (first := source.read()).stats is None:
        if time.monotonic() > deadline_s:
            raise NoServer("the server publishes no statistics; is it suspended?")
        time.sleep(POLL_S)
    source.watch([row.name for row in _choose_robots(first, given)[: given.rates]])
    # Meanwhile each process has reported, and publishers of odometry have their subscriber.
    time.sleep(REPORT_S)
    first = source.read()
    time.sleep(REPORT_S)
    return first, source.read()


def _choose_robots(reading: FleetReading, given: TopOptions) -> list[RobotRow]:
    chosen = filter_rows(list_robot_rows(reading), given.text)
    is_number = given.sort in ("x", "y", "speed", "odom_hz")
    return sort_rows(chosen, given.sort, is_descending=is_number)


def _make_table(titles: dict[str, str], rows: Sequence[Row]) -> Table:
    table = Table(box=None)
    is_vehicle_known = any(getattr(row, "order", None) is not None for row in rows)
    titles = {one: title for one, title in titles.items() if one != "order" or is_vehicle_known}
    for column, title in titles.items():
        is_number = any(isinstance(getattr(row, column), (int, float)) for row in rows)
        table.add_column(title, justify="right" if is_number else "left")
    for row in rows:
        values = msgspec.structs.asdict(row)
        # As Text: names must not be parsed as markup.
        table.add_row(*(Text(printable(format_value(one, values[one]))) for one in titles))
    return table
