"""`zensim sweep`: run a scenario with many values, seeds and repeats."""

import os
import signal
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from types import FrameType
from typing import Annotated, Literal

import msgspec
import typer
from typer.core import TyperGroup

from zensim.deploy.cli.plot_commands import SUFFIXES, MissingPlotExtra
from zensim.deploy.cli.scenario_commands import PythonOption, RunTimeoutOption
from zensim.deploy.scenario_process import RunRequest, run_in_processes
from zensim.deploy.sweep.ray_runs import MissingRayExtra, check_cluster, require_ray, run_on_ray
from zensim.deploy.sweep.sweep_folder import SweepFolder
from zensim.deploy.sweep.sweep_plan import SweepPlan, SweepRun, make_plan
from zensim.deploy.sweep.sweep_plots import draw_margins
from zensim.deploy.sweep.sweep_progress import SweepProgress
from zensim.deploy.sweep.sweep_report import format_groups, group_rows
from zensim.deploy.sweep.sweep_rows import SweepRow, find_unequal_repeats
from zensim.deploy.sweep.sweep_runner import ATTEMPTS, Runner, run_here, run_sweep
from zensim.proto.exit_codes import ExitCode, exit_on_failure
from zensim.proto.options.command_options import JsonOption, SetOption, flag
from zensim.proto.options.option_groups import make_app
from zensim.proto.printable_text import print_lines
from zensim.proto.verbosity import CURRENT, print_note
from zensim.scenario.scenario_nodes import ScenarioInvalid
from zensim.scenario.scenario_reader import find_scenario_file
from zensim.sim_server.server_extra import MissingServerExtra, server_extra

NOTE_EVERY_S = 5.0
"""Wall time between lines of progress."""


class DefaultCommandGroup(TyperGroup):
    """A group whose command `run` is meant where no command is named."""

    default_command = "run"

    def parse_args(self, ctx: typer.Context, args: list[str]) -> list[str]:  # type: ignore[override]
        """Name the command, where the first word is none."""
        is_named = not args or args[0] in self.commands
        return super().parse_args(ctx, args if is_named else [self.default_command, *args])


app = make_app("sweep")
app.info.cls = DefaultCommandGroup


@dataclass(frozen=True, kw_only=True)
class SweepOptions:
    """All options of `zensim sweep FILE`."""

    file: Annotated[
        str, typer.Argument(metavar="FILE", help="Scenario file, or name of a shipped scenario.")
    ]
    settings: SetOption = None
    on: Annotated[
        Literal["here", "processes", "ray"],
        typer.Option(
            "--on", metavar="PLACE", help="here = in this process; processes; ray = tasks of Ray."
        ),
    ] = "processes"
    jobs: Annotated[
        int | None,
        typer.Option(
            "--jobs",
            "-j",
            min=1,
            metavar="N",
            help="Number of runs at once.",
            show_default="CPU cores",
        ),
    ] = None
    ray_address: Annotated[
        str,
        typer.Option(
            "--ray-address",
            metavar="ADDRESS",
            help="Ray cluster, for --on ray; local = one of this command.",
            show_default="RAY_ADDRESS, or local",
        ),
    ] = ""
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            metavar="FOLDER",
            help="Folder of the results; what is there is not run again.",
            show_default="NAME.sweep",
        ),
    ] = None
    only: Annotated[
        str, typer.Option("--only", metavar="I/N", help="Only the I-th of N shares of the runs.")
    ] = ""
    retries_errors: Annotated[
        bool, flag("--retry-errors", help="Run again what did not run to its end.")
    ] = False
    records: Annotated[
        bool,
        typer.Option(
            "--record/--no-record", metavar="", help="Run what failed again, and record it."
        ),
    ] = True
    python: PythonOption = True
    timeout: RunTimeoutOption = None
    as_json: JsonOption = False


@app.command(
    name="run",
    epilog="""Examples:
  zensim sweep crossing.scenario.yaml --jobs 8
  zensim sweep crossing.scenario.yaml --only 3/10 --output shared/crossing
  zensim sweep report crossing.sweep --by behaviours.cross.speed --plot margins.png""",
)
def run_command(given: SweepOptions) -> None:
    """Run all combinations of `vary`; what has ended before is not run again.

    Exit status: 0 if every run passed, 6 if one did not, 2 if the file has mistakes, 130 if it
    was interrupted. The word `run` may be left out.
    """
    with exit_on_failure("sweep", MissingServerExtra, MissingRayExtra), _interrupted_by_sigterm():
        with server_extra():
            from zensim.sim_server.description import strict_xml  # noqa: F401  # for runs
        runner = _choose_runner(given)
        plan = _make_plan(given)
        folder = SweepFolder(given.output or Path(f"{plan.name.replace('/', '_')}.sweep"))
        share = _choose_share(plan.runs, given.only)
        folder.open(plan)
        try:
            _run_rest(plan, share, folder, runner, given)
        finally:
            rows = _write_results(plan, folder, is_share=bool(given.only))
        is_good = _report_end(rows, share, folder)
    if not is_good:
        raise typer.Exit(ExitCode.PARTIAL)


@contextmanager
def _interrupted_by_sigterm() -> Iterator[None]:
    before = signal.signal(signal.SIGTERM, _interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _interrupt(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


def _make_plan(given: SweepOptions) -> SweepPlan:
    file, shown = find_scenario_file(given.file), PlanProgress()
    try:
        return make_plan(file, given.settings or (), shown.count_run)
    except ScenarioInvalid as error:
        for issue in error.issues:
            print_lines(str(issue), err=True)
        raise typer.Exit(ExitCode.USAGE) from error


def _choose_runner(given: SweepOptions) -> Runner:
    if given.ray_address and given.on != "ray":
        raise ValueError("--ray-address needs --on ray; add it")
    if given.on == "ray":
        require_ray()
        check_cluster(given.ray_address)
        return partial(run_on_ray, jobs=given.jobs, address=given.ray_address)
    if given.on == "here":
        if given.jobs not in (None, 1):
            raise ValueError(f"--on here runs one at a time, not --jobs {given.jobs}")
        return run_here
    jobs = given.jobs or os.cpu_count() or 1
    return partial(run_in_processes, jobs=jobs, attempts=ATTEMPTS)


def _choose_share(runs: Sequence[SweepRun], only: str) -> list[SweepRun]:
    """Choose the runs of a share, such as 3/10; all without one."""
    if not only:
        return list(runs)
    index, _, count = only.partition("/")
    if not (index.isdecimal() and count.isdecimal() and 1 <= int(index) <= int(count)):
        raise ValueError(f"--only {only} is no share; use I/N with I from 1 to N, such as 3/10")
    return list(runs[int(index) - 1 :: int(count)])


def _run_rest(
    plan: SweepPlan,
    share: Sequence[SweepRun],
    folder: SweepFolder,
    runner: Runner,
    given: SweepOptions,
) -> None:
    """Run what has no row yet."""
    known = folder.read_rows([run.id for run in share])
    kept = [row for row in known if not (given.retries_errors and row.error)]
    ids = {row.id for row in kept}
    left = [run for run in share if run.id not in ids]
    for row in known:
        if row.id not in ids:
            folder.remove_recording(row.id)
    requests = [_make_request(plan, run, folder, given) for run in left]
    failed = sum(not row.is_passed for row in kept)
    shown = ProgressLine(SweepProgress(len(share), len(kept), failed), as_json=given.as_json)
    run_sweep(left, requests, folder, runner, shown.show_row)


def _make_request(
    plan: SweepPlan, run: SweepRun, folder: SweepFolder, given: SweepOptions
) -> RunRequest:
    return RunRequest(
        plan.file,
        run.settings,
        allows_python=given.python,
        timeout_s=run.timeout_s if given.timeout is None else given.timeout,
        has_own_timeout=given.timeout is not None,
        failure_recording=str(folder.find_recording(run.id)) if given.records else "",
        recorded_topics=plan.recorded_topics,
    )


def _write_results(plan: SweepPlan, folder: SweepFolder, *, is_share: bool) -> list[SweepRow]:
    """Write the table of all rows; a share writes it only if the rows of all shares are there."""
    rows = folder.read_rows([run.id for run in plan.runs])
    if rows and (not is_share or len(rows) == len(plan.runs)):
        file = folder.write_results(rows)
        if not CURRENT.is_json:
            print_note("sweep", f"{len(rows)} rows in {file}")
    return rows


def _report_end(rows: Sequence[SweepRow], share: Sequence[SweepRun], folder: SweepFolder) -> bool:
    """Print what failed, and return whether nothing did."""
    ids = {run.id for run in share}
    failed = [row for row in rows if row.id in ids and not row.is_passed]
    unequal = [one for one in find_unequal_repeats(rows) if not ids.isdisjoint(one)]
    for row in failed[:10]:
        reason = row.error or f"failed: {', '.join(row.failed)}"
        print_note("sweep", f"{row.id}: {' '.join(reason.split())}; repeat: {row.command}")
    if len(failed) > 10:  # noqa: PLR2004  lines of a terminal
        print_note("sweep", f"{len(failed) - 10} more failed; zensim sweep report {folder.path}")
    for ids_of_equal in unequal:
        print_note("sweep", f"not deterministic: {', '.join(ids_of_equal)} ended in unequal states")
    return not failed and not unequal


class PlanProgress:
    """Progress of the making of runs, on standard error, if it takes long."""

    def __init__(self) -> None:
        self._count = 0
        self._shown_s = time.monotonic()

    def count_run(self, _: SweepRun) -> None:
        """Count a run that was validated."""
        self._count += 1
        if time.monotonic() - self._shown_s >= NOTE_EVERY_S:
            self._shown_s = time.monotonic()
            print_note("sweep", f"{self._count} runs validated so far")


class ProgressLine:
    """Progress on standard error, and with `--json` each row on standard output."""

    def __init__(self, progress: SweepProgress, *, as_json: bool) -> None:
        self._progress = progress
        self._as_json = as_json
        self._began_s = time.monotonic()
        self._shown_s = self._began_s
        self._show()

    def show_row(self, row: SweepRow) -> None:
        """Count a row, and show it."""
        elapsed_s = time.monotonic() - self._began_s
        self._progress = self._progress.add(is_passed=row.is_passed, elapsed_s=elapsed_s)
        if self._as_json:
            line = {
                "done": self._progress.done,
                "total": self._progress.total,
                "failed": self._progress.failed,
                "left_s": self._progress.left_s,
                "row": row,
            }
            print_lines(msgspec.json.encode(line).decode())
        is_last = self._progress.done == self._progress.total
        if is_last or time.monotonic() - self._shown_s >= NOTE_EVERY_S:
            self._show()

    def _show(self) -> None:
        if CURRENT.is_quiet:
            return
        self._shown_s = time.monotonic()
        print_lines(f"zensim sweep: {self._progress}", err=True)


@dataclass(frozen=True, kw_only=True)
class SweepReportOptions:
    """All options of `zensim sweep report`."""

    folder: Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of a sweep.")]
    by: Annotated[
        list[str] | None,
        typer.Option(
            "--by",
            metavar="KEY",
            help="Group the runs by this key; repeatable.",
            show_default="all keys that vary",
        ),
    ] = None
    plot: Annotated[
        Path | None,
        typer.Option("--plot", metavar="FILE", help="Picture to draw: .png, .svg or .pdf."),
    ] = None
    as_json: JsonOption = False


@app.command(name="report")
def report_command(given: SweepReportOptions) -> None:
    """Print a table of the runs of a sweep by their values, and draw margins over them."""
    with exit_on_failure("sweep report", MissingPlotExtra):
        folder = SweepFolder(given.folder)
        plan = folder.read_plan()
        rows = folder.read_rows(plan.ids)
        if not rows:
            raise ValueError(f"no run of {given.folder} has ended; run zensim sweep {plan.file}")
        by = plan.paths if given.by is None else given.by
        if unknown := [path for path in by if path not in plan.paths]:
            known = ", ".join(plan.paths) or "nothing"
            raise ValueError(f"--by {unknown[0]} does not vary; what varies: {known}")
        file = folder.write_results(rows)
        panels = 0 if given.plot is None else _draw(rows, given.plot, plan.name)
    groups = group_rows(rows, by)
    if given.as_json:
        facts = {"runs": len(rows), "planned": len(plan.ids), "table": str(file), "groups": groups}
        print_lines(msgspec.json.encode(facts).decode())
        return
    print_lines(format_groups(groups))
    print_note("sweep report", f"{len(rows)} of {len(plan.ids)} runs, {file}")
    if given.plot is not None:
        print_note("sweep report", f"{given.plot}: {panels} panels")


def _draw(rows: Sequence[SweepRow], target: Path, title: str) -> int:
    if target.suffix not in SUFFIXES:
        raise ValueError(f"--plot {target.name} has no known format; use {', '.join(SUFFIXES)}")
    if find_spec("matplotlib") is None:
        raise MissingPlotExtra("matplotlib is not installed; use pip install 'zensim[plot]'")
    if not any(row.margins for row in rows):
        raise ValueError("no run has a margin to draw: the scenario has no checks")
    return draw_margins(rows, target, title=title)
