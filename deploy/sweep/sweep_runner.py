"""Runs what is left of a sweep; each row is kept as soon as its run has ended."""

import signal
import threading
import time
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import closing, contextmanager
from pathlib import Path
from typing import NoReturn

from zensim.deploy.scenario_process import RunRequest, make_error_report, run_request
from zensim.deploy.sweep.sweep_folder import SweepFolder
from zensim.deploy.sweep.sweep_plan import SweepRun
from zensim.deploy.sweep.sweep_rows import SweepRow, make_row
from zensim.scenario.scenario_runner import RunReport

ATTEMPTS = 4
"""Attempts at a run whose process is killed by others."""
ALARM_AT_ONCE_S = 0.001

EndedRuns = Generator[tuple[int, RunReport], None, None]
"""Numbers of requests and their reports, in the order in which they end."""
Runner = Callable[[Sequence[RunRequest]], EndedRuns]


class ScenarioChanged(ValueError):
    """The file of a sweep is another one than at its start."""


class _TimeIsOver(BaseException):
    """The wall time of a run in this process is over; no code of its author catches it."""


def run_sweep(
    runs: Sequence[SweepRun],
    requests: Sequence[RunRequest],
    folder: SweepFolder,
    runner: Runner,
    on_row: Callable[[SweepRow], None],
) -> None:
    """Run a part of a sweep.

    Args:
        runs: Without a row.
        requests: One for each run.
        folder: For the rows.
        runner: Performs the requests.
        on_row: Called after a row was kept.

    Raises:
        ScenarioChanged: The file was changed since the plan was made, or cannot be read.
        OSError: A row cannot be kept.
    """
    with closing(runner(requests)) as ended:
        for number, report in ended:
            run, request = runs[number], requests[number]
            if report.sha256 != run.sha256:
                reason = "has changed since the sweep began" if report.sha256 else report.error
                raise ScenarioChanged(
                    f"{request.file}: {reason}; start the sweep again: "
                    "runs that are still part of it are kept"
                )
            row = make_row(run, report, _find_recording(report, folder))
            folder.write_row(row)
            on_row(row)


def _find_recording(report: RunReport, folder: SweepFolder) -> str:
    """Find the recording of a run in a folder; on another host there may be none here."""
    path = Path(report.recording)
    return (
        str(path.relative_to(folder.path.resolve())) if report.recording and path.exists() else ""
    )


def run_here(requests: Sequence[RunRequest]) -> EndedRuns:
    """Run scenarios in this process, one after another."""
    for number, request in enumerate(requests):
        yield number, run_within_time(request)


def run_within_time(request: RunRequest) -> RunReport:
    """Run a scenario in this process, and interrupt its Python code at the timeout.

    Only the main thread can do that, and not on Windows; elsewhere there is no timeout.
    """
    began_s = time.time()
    try:
        with _limited_time(request.timeout_s):
            return run_request(request)
    except _TimeIsOver:
        failure = f"timeout: not over after {request.timeout_s:g} s of wall time"
        return make_error_report(request, failure, began_s)


@contextmanager
def _limited_time(seconds: float) -> Iterator[None]:
    is_main = threading.current_thread() is threading.main_thread()
    if not is_main or not hasattr(signal, "setitimer"):
        yield
        return
    before = signal.signal(signal.SIGALRM, _end_time)
    began_s = time.monotonic()
    left_s, _ = signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)
        if left_s:  # an alarm of the caller; 0 would stop it
            passed_s = time.monotonic() - began_s
            signal.setitimer(signal.ITIMER_REAL, max(left_s - passed_s, ALARM_AT_ONCE_S))


def _end_time(_number: int, _frame: object) -> NoReturn:
    raise _TimeIsOver
