"""`zensim down`: end what `zensim up` runs on this host."""

from collections.abc import Sequence
from typing import Annotated

import msgspec
import typer

from zensim.deploy.local_runs import LocalRun, end_run, list_runs
from zensim.proto.exit_codes import exit_on_failure
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.options.command_options import JsonOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines

app = make_app()


class NothingRuns(Exception):
    """No `zensim up` runs here, or none at that endpoint."""

    code = ResultCode.NOT_FOUND


class StillRuns(Exception):
    """A `zensim up` did not end in time."""


@app.command(
    epilog="""Examples:
  zensim down
  zensim down --listen tcp/127.0.0.1:7448
  zensim down --all"""
)
def down(
    *,
    listen: Annotated[
        str,
        typer.Option("--listen", metavar="ENDPOINT", help="End only the world of this endpoint."),
    ] = "",
    everything: Annotated[bool, flag("--all", help="End all of them, if several run.")] = False,
    as_json: JsonOption = False,
) -> None:
    """End what 'zensim up' runs on this host: page, agents, server."""
    with exit_on_failure("down", NothingRuns, StillRuns):
        runs = choose_runs(list_runs(), listen, everything=everything)
        for run in runs:
            if not end_run(run):
                raise StillRuns(f"process {run.process_id} at {run.endpoint} has not ended")
            if not as_json:
                print_lines(f"ended {_name(run)}")
    if as_json:
        print_lines(msgspec.json.encode(runs).decode())


def choose_runs(runs: Sequence[LocalRun], listen: str, *, everything: bool) -> list[LocalRun]:
    """Choose the runs to end.

    Raises:
        NothingRuns: There is none, or none with that endpoint.
        ValueError: There are several, and none is chosen.
    """
    chosen = [run for run in runs if not listen or run.endpoint == listen]
    if not chosen:
        others = f"; there are: {', '.join(map(_name, runs))}" if runs else ""
        at = f" at {listen}" if listen else ""
        raise NothingRuns(f"no 'zensim up' of this user runs{at}{others}")
    if len(chosen) > 1 and not everything:
        raise ValueError(
            f"{len(chosen)} are running: {', '.join(map(_name, chosen))}; choose one with "
            "--listen, or use --all"
        )
    return chosen


def _name(run: LocalRun) -> str:
    return f"world '{run.world}' at {run.endpoint} (process {run.process_id})"
