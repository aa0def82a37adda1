"""Run pytest, and run again, once and alone, what failed: at most five tests of a whole run.

Usage: run_tests.py [OPTION OF PYTEST...], without paths, in the root of the repository. What passes
alone is named at the end, and in build/passed_alone.txt: it depends on load or on other tests,
which is a defect to mend. The exit status is that of pytest, and 1 if a test failed twice.
"""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import TypedDict

import pytest

MOST_AGAIN = 5
"""More failures have a common cause, which is not load."""
ALONE = ("-n", "0")
"""In one process, one after another; the last `-n` counts."""
PASSED_ALONE = Path("build/passed_alone.txt")


class Outcome(TypedDict):
    """What became of a run of pytest."""

    status: int
    passed: list[str]
    failed: list[str]
    """Tests that failed, set-up, clean-up and crashed workers included."""
    is_whole: bool
    """Whether each test that was selected ran, and all could be listed."""


class Recorder:
    """Collects the ids of tests; of a run with workers, in the process that starts them."""

    def __init__(self) -> None:
        self._passed: dict[str, None] = {}
        self._failed: dict[str, None] = {}
        self._seen: set[str] = set()
        self._is_whole = True

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Note that a file, or a worker, could not list its tests."""
        self._is_whole = self._is_whole and not report.failed

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a test that failed in any phase, or passed."""
        self._seen.add(report.nodeid)
        if report.failed:
            self._failed[report.nodeid] = None
        elif report.passed and report.when == "call":
            self._passed[report.nodeid] = None

    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Note whether tests were left out, as by workers that crash again and again."""
        self._is_whole = self._is_whole and len(self._seen) == session.testscollected

    def outcome(self, status: int) -> Outcome:
        """Sum up; a test that passed and failed to clean up failed."""
        return Outcome(
            status=status,
            passed=[test for test in self._passed if test not in self._failed],
            failed=list(self._failed),
            is_whole=self._is_whole,
        )


def record(target: Path, arguments: list[str]) -> int:
    """Run pytest in this process, and write its outcome to a file."""
    recorder = Recorder()
    status = int(pytest.main(arguments, plugins=[recorder]))
    target.write_text(json.dumps(recorder.outcome(status)))
    return status


def run(arguments: list[str]) -> Outcome:
    """Run pytest in a process of its own; it handles Ctrl-C."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "outcome.json"
        command = [sys.executable, __file__, "--record", str(target), *arguments]
        process = subprocess.Popen(command)
        while True:
            try:
                status = process.wait()
                break
            except KeyboardInterrupt:
                continue
        if not target.exists():
            return Outcome(status=status or 1, passed=[], failed=[], is_whole=False)
        found: Outcome = {**json.loads(target.read_text()), "status": status}
        return found


def is_worth_another(outcome: Outcome) -> bool:
    """Whether all tests ran, and few failed."""
    return (
        outcome["status"] == pytest.ExitCode.TESTS_FAILED
        and outcome["is_whole"]
        and 0 < len(outcome["failed"]) <= MOST_AGAIN
    )


def name_those_that_passed(tests: list[str]) -> None:
    """Print the tests that failed among others and passed alone, and keep their names."""
    text = "".join(f"{test}\n" for test in tests)
    with PASSED_ALONE.open("a") as file:
        file.write(text)
    sys.stdout.write(f"failed among others and passed alone; each is a defect to mend:\n{text}")


def main(arguments: list[str]) -> int:
    """Run the tests, and those that failed again."""
    PASSED_ALONE.parent.mkdir(exist_ok=True)
    PASSED_ALONE.touch()  # now, because a later run as root would own it
    first = run(arguments)
    if not is_worth_another(first):
        return first["status"]
    failed = first["failed"]
    sys.stdout.write(f"\n{len(failed)} failed; they run again, alone\n\n")
    sys.stdout.flush()
    second = run([*arguments, *ALONE, *failed])
    passed = [test for test in failed if test in second["passed"]]
    if passed:
        name_those_that_passed(passed)
    twice = [test for test in failed if test not in passed]
    if twice:
        sys.stdout.write("".join(f"did not pass alone either: {test}\n" for test in twice))
    return second["status"] or int(bool(twice))


if __name__ == "__main__":
    if sys.argv[1:2] == ["--record"]:
        sys.exit(record(Path(sys.argv[2]), sys.argv[3:]))
    sys.exit(main(sys.argv[1:]))
