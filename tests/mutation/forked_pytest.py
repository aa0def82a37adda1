"""Runs of pytest in forked processes: libraries are imported once, the code anew for each run."""

import ctypes
import json
import os
import resource
import signal
import sys
import tempfile
import time
import types
from collections.abc import Collection, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

import psutil
import pytest
from coverage import Coverage

LIBRARIES = ("hypothesis", "lxml.etree", "mujoco", "numpy", "pybullet", "trimesh", "zenoh")
OWN_PACKAGES = ("benchmarks", "tests", "zensim")
PASSED = (pytest.ExitCode.OK, pytest.ExitCode.NO_TESTS_COLLECTED)
MARKS = "not short_form and not browser and not root and not interop"
OPTIONS = (
    *("-q", "--tb=no", "-m", MARKS, "-p", "no:cacheprovider", "-p", "no:faulthandler"),
    *("--timeout", "120"),
    *("-W", "ignore::pytest.PytestAssertRewriteWarning"),  # of plugins that are imported
)
MAX_MEMORY_BYTES = 8 << 30
"""Of address space: a mutant may append for ever."""
POLL_S = 0.01
PR_SET_PDEATHSIG = 1


@dataclass
class PytestRun:
    """What a run of tests showed.

    Attributes:
        seconds: Time of each test that ran, with its fixtures.
        failed: Tests that failed, and files that could not be imported.
        lines: For each measured module, line and the tests that reached it; "" is its import.
        ended: Why the run has no further results: a time limit, a crash; empty if it has.
    """

    seconds: dict[str, float] = field(default_factory=dict)
    failed: list[str] = field(default_factory=list)
    lines: dict[str, dict[int, list[str]]] = field(default_factory=dict)
    ended: str = ""


@dataclass(frozen=True)
class ChosenTests:
    """Which tests to run.

    Attributes:
        files: Test files, by their path in the tree.
        tests: Those to run of them; all if None.
        measured: Modules whose lines are recorded, by their path in the tree.
        is_ended_by_failure: Whether the first failure ends the run.
        left_out: Tests, or whole files, that do not run.
    """

    files: Sequence[str]
    tests: Collection[str] | None = None
    measured: Sequence[str] = ()
    is_ended_by_failure: bool = True
    left_out: frozenset[str] = frozenset()


def import_libraries() -> None:
    """Import what all tests need, before the first run."""
    for name in LIBRARIES:
        import_module(name)


def run_tests(tree: Path, choice: ChosenTests, timeout_s: float) -> PytestRun:
    """Run tests of a tree in a process of their own.

    Args:
        tree: A copy of the repository.
        choice: Which tests.
        timeout_s: Then the run and all its processes are killed.
    """
    with tempfile.TemporaryDirectory(prefix="zensim-run-") as folder:
        file = Path(folder) / "run.json"
        if not (child := os.fork()):
            _run_and_exit(tree, choice, file)
        is_in_time = _wait(child, timeout_s)
        if file.exists():
            return _read(file)
    return PytestRun(ended="crash" if is_in_time else "time limit")


class _Recorder:
    """A plugin of pytest that chooses tests and keeps what they did."""

    def __init__(self, choice: ChosenTests, coverage: Coverage | None) -> None:
        self.run = PytestRun()
        self._choice = choice
        self._coverage = coverage

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        tests, left_out = self._choice.tests, self._choice.left_out
        items[:] = [
            item
            for item in items
            if item.nodeid not in left_out and (tests is None or item.nodeid in tests)
        ]

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        if self._coverage is not None:
            self._coverage.switch_context(nodeid)

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        seconds = self.run.seconds
        seconds[report.nodeid] = seconds.get(report.nodeid, 0.0) + report.duration
        if report.failed:
            self.run.failed.append(report.nodeid)

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed:
            self.run.failed.append(report.nodeid)


def _run_and_exit(tree: Path, choice: ChosenTests, file: Path) -> None:
    """Run pytest in this forked process, and end it without what its parent would do at exit."""
    try:
        _enter(tree)
        coverage = _measure(tree, choice.measured)
        recorder = _Recorder(choice, coverage)
        words = [*OPTIONS, *(["-x"] if choice.is_ended_by_failure else ()), *choice.files]
        status = pytest.main(words, plugins=[recorder])
        if status not in PASSED and not recorder.run.failed:
            recorder.run.failed.append(f"pytest: status {int(status)}")
        if coverage is not None:
            coverage.stop()
            recorder.run.lines = _read_lines(tree, coverage)
        part = file.with_suffix(".part")
        part.write_text(json.dumps(recorder.run.__dict__), "utf-8")
        part.rename(file)
    finally:
        os._exit(0)


def _enter(tree: Path) -> None:
    """Let this process and its children import the code of a tree."""
    os.setsid()
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY_BYTES, hard))
    null = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(null, descriptor)
    os.chdir(tree)
    os.environ["PYTHONPATH"] = str(tree)
    for name in [name for name in sys.modules if name.partition(".")[0] in OWN_PACKAGES]:
        del sys.modules[name]
    sys.modules["__main__"] = types.ModuleType("__main__")  # child processes would import ours
    sys.path[:] = [str(tree), *(path for path in sys.path if not (Path(path) / "zensim").is_dir())]


def _measure(tree: Path, modules: Sequence[str]) -> Coverage | None:
    if not modules:
        return None
    places = [str((tree / module).resolve()) for module in modules]
    coverage = Coverage(data_file=None, config_file=False, include=places)
    coverage.start()
    return coverage


def _read_lines(tree: Path, coverage: Coverage) -> dict[str, dict[int, list[str]]]:
    data, root = coverage.get_data(), tree.resolve()
    return {
        str(Path(file).relative_to(root)): data.contexts_by_lineno(file)
        for file in data.measured_files()
    }


def _read(file: Path) -> PytestRun:
    run = PytestRun(**json.loads(file.read_text("utf-8")))
    run.lines = {
        module: {int(line): tests for line, tests in lines.items()}
        for module, lines in run.lines.items()
    }
    return run


def _wait(child: int, timeout_s: float) -> bool:
    """Wait for a process; kill it and its children after a time. Return whether it was in time."""
    deadline_s = time.monotonic() + timeout_s
    while os.waitpid(child, os.WNOHANG)[0] == 0:
        if time.monotonic() > deadline_s:
            _kill(child)
            os.waitpid(child, 0)
            return False
        time.sleep(POLL_S)
    return True


def _kill(child: int) -> None:
    for process in [*psutil.Process(child).children(recursive=True), psutil.Process(child)]:
        with suppress(psutil.NoSuchProcess):
            process.send_signal(signal.SIGKILL)
