"""Workers of a run of tests: forks of the process that has read them.

Each worker of pytest-xdist reads all tests anew, which costs 14 s of processor time, and 30 s in a
checkout whose modules nobody compiled. A fork has them, and shares their memory.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
import traceback
from collections import deque
from itertools import groupby
from multiprocessing.connection import Connection, Pipe, wait
from typing import TYPE_CHECKING

import pytest
from _pytest.config import create_terminal_writer

if TYPE_CHECKING:
    import argparse
    from collections.abc import Iterator, Sequence
    from pathlib import Path

CRASHES_PER_WORKER = 4
"""A run whose workers crash more often ends."""
ENDED_BY_ERROR = 3


class Worker:
    """A forked process, as its parent sees it."""

    def __init__(self, pid: int, connection: Connection) -> None:
        self.pid = pid
        self.end = os.pidfd_open(pid)
        self.connection = connection
        self.todo: deque[int] = deque()
        """Numbers of the tests that it took and did not end; it runs the first."""

    def close(self) -> int:
        """Wait for its end; return its exit status, negative for a signal."""
        self.connection.close()
        os.close(self.end)
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


class ForkedWorkers:
    """A plug-in of pytest: `--workers N` runs the tests in N forks."""

    def __init__(self) -> None:
        self._workers: list[Worker] = []
        self._groups: deque[list[int]] = deque()
        self._forked = 0

    def pytest_addoption(self, parser: pytest.Parser) -> None:
        """Add the options."""
        parser.addoption("--workers", type=int, default=0, help="Forked processes; 0: none.")
        parser.addoption(
            "--together",
            choices=["file", "test"],
            default="file",
            help="What one worker runs, in its order: the tests of a file, or one test.",
        )

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool | None:
        """Run the tests in forks; let pytest run them if there shall be none."""
        option = session.config.option
        if not option.workers or option.collectonly or session.testsfailed or not session.items:
            return None
        self._groups.extend(group_items(session.items, option))
        session.config.pluginmanager.get_plugin("terminalreporter").showfspath = False
        try:
            for _ in range(min(option.workers, len(self._groups))):
                self._fork(session)
            while self._workers:
                self._take_messages(session)
        finally:
            for worker in self._workers:
                worker.connection.close()  # ends it after the test that it runs
            while self._workers:
                self._workers.pop().close()
        return True

    def _fork(self, session: pytest.Session) -> None:
        ours, theirs = Pipe()
        base = session.config._tmp_path_factory.getbasetemp()  # noqa: SLF001
        name = f"gw{self._forked}"
        self._forked += 1
        sys.stdout.flush()
        sys.stderr.flush()
        if (pid := os.fork()) == 0:
            ours.close()
            for worker in self._workers:
                worker.connection.close()
                os.close(worker.end)
            run_forked(session, theirs, base / name)
        theirs.close()
        self._workers.append(Worker(pid, ours))

    def _take_messages(self, session: pytest.Session) -> None:
        """Wait for workers, and handle one message of each; see those that ended."""
        sources = {worker.connection: worker for worker in self._workers}
        sources |= {worker.end: worker for worker in self._workers}
        ready = wait(sources)
        for worker in {id(sources[one]): sources[one] for one in ready}.values():
            try:
                reports = worker.connection.recv() if worker.connection.poll() else ()
            except (EOFError, ConnectionError):
                reports = ()
            if reports:
                self._report(session, worker, reports)
            elif reports is None:
                self._give(worker)
            else:
                self._see_end(session, worker)

    def _give(self, worker: Worker) -> None:
        group = self._groups.popleft() if self._groups else []
        worker.todo.extend(group)
        with contextlib.suppress(ConnectionError):  # its end is seen next
            worker.connection.send(group)

    def _report(
        self, session: pytest.Session, worker: Worker, reports: list[dict[str, object]]
    ) -> None:
        hook = session.config.hook
        item = session.items[worker.todo.popleft()]
        hook.pytest_runtest_logstart(nodeid=item.nodeid, location=item.location)
        for data in reports:
            report = hook.pytest_report_from_serializable(config=session.config, data=data)
            hook.pytest_runtest_logreport(report=report)
        hook.pytest_runtest_logfinish(nodeid=item.nodeid, location=item.location)
        stop_if_asked(session)

    def _see_end(self, session: pytest.Session, worker: Worker) -> None:
        """Take a worker out; report the test in which it crashed, and fork another."""
        self._workers.remove(worker)
        status = worker.close()
        if worker.todo:
            report_crash(session, session.items[worker.todo.popleft()], status)
            self._groups.appendleft(list(worker.todo))
        if self._forked > (CRASHES_PER_WORKER + 1) * session.config.option.workers:
            raise session.Failed("workers crash again and again")
        if status and self._groups:
            self._fork(session)


def group_items(items: Sequence[pytest.Item], option: argparse.Namespace) -> Iterator[list[int]]:
    """Group the numbers of tests that one worker runs; files keep the place of their first test."""
    if option.together == "test":
        yield from ([number] for number in range(len(items)))
        return
    for _, group in groupby(range(len(items)), lambda number: items[number].path):
        yield list(group)


def report_crash(session: pytest.Session, item: pytest.Item, status: int) -> None:
    """Report a test that ended its worker as failed."""
    text = f"the worker crashed while it ran this test: exit status {status}"
    report = pytest.TestReport(item.nodeid, item.location, {}, "failed", text, "call")
    session.config.hook.pytest_runtest_logreport(report=report)
    stop_if_asked(session)


def stop_if_asked(session: pytest.Session) -> None:
    """End the run after so many failures as its options say."""
    if session.shouldfail:
        raise session.Failed(session.shouldfail)
    if session.shouldstop:
        raise session.Interrupted(session.shouldstop)


def run_forked(session: pytest.Session, connection: Connection, base: Path) -> None:
    """Run tests in this forked process as its parent gives them, and end it."""
    status = ENDED_BY_ERROR
    errors = os.dup(2)
    try:
        atexit._clear()  # noqa: SLF001 - what the parent does at its exit
        become_worker(session.config, base)
        reports = Reports(session.config)
        session.config.pluginmanager.register(reports)
        try:
            run_items(session, connection, reports)
        finally:
            session._setupstate.teardown_exact(None)  # noqa: SLF001
        atexit._run_exitfuncs()  # noqa: SLF001
        status = 0
    except (ConnectionError, EOFError, KeyboardInterrupt):
        atexit._run_exitfuncs()  # noqa: SLF001 - the run is over
    except BaseException:  # noqa: BLE001
        os.write(errors, traceback.format_exc().encode(errors="replace"))
    finally:
        os._exit(status)


def become_worker(config: pytest.Config, base: Path) -> None:
    """Separate this fork from its parent: output, captured output, temporary files."""
    manager = config.pluginmanager
    os.environ["PYTEST_XDIST_WORKER"] = base.name  # the name that tools know
    if (capture := manager.get_plugin("capturemanager")) is not None:
        capture.stop_global_capturing()  # whose file is that of the parent
        capture.start_global_capturing()
    silent = open(os.devnull, "w")  # noqa: PTH123, SIM115
    manager.get_plugin("terminalreporter")._tw = create_terminal_writer(config, silent)  # noqa: SLF001
    base.mkdir(mode=0o700)
    config._tmp_path_factory._basetemp = base  # noqa: SLF001


class Reports:
    """A plug-in of pytest in a worker: the reports of the test that runs."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self.reports: list[dict[str, object]] = []

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Keep a report."""
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        self.reports.append(data)


def run_items(session: pytest.Session, connection: Connection, reports: Reports) -> None:
    """Run tests until there are no more; the next one is known when one begins."""
    numbers = take_numbers(connection)
    number = next(numbers, None)
    while number is not None:
        following = next(numbers, None)
        item = session.items[number]
        item.config.hook.pytest_runtest_protocol(
            item=item, nextitem=None if following is None else session.items[following]
        )
        connection.send(reports.reports)
        reports.reports = []
        number = following


def take_numbers(connection: Connection) -> Iterator[int]:
    """Ask for a group of tests when all before were taken."""
    while True:
        connection.send(None)
        if not (group := connection.recv()):
            return
        yield from group
