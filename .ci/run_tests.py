"""Run pytest, and run again, once and alone, what failed: at most five tests of a whole run.

Usage: run_tests.py [OPTION OF PYTEST...], without paths, in the root of the repository. What passes
alone is named at the end, and in build/passed_alone.txt: it depends on load or on other tests,
which is a defect to mend. The exit status is that of pytest, and 1 if a test failed twice.
"""

from __future__ import annotations

import json
import os
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
DURATIONS = Path("build/test_durations.json")
"""Wall and processor seconds of each test when it last ran, set-up and clean-up included."""
SLOWEST = 10
"""Files and tests that the end of a run names, and tests that failed."""
FILE_CPU_S = 20.0
"""Processor time of a file above which the end of a run names it."""
SHARE_VARIABLE = "FILE_CPU_SHARE"
"""Share of the processor time of all files above which a file that is not listed fails the run;
unset: none does. A slower processor takes longer for all files, so the share is the same."""
LONG_FILES = {
    "tests/contract/test_one_loop.py": "each scenario runs twice, here and on a server",
    "tests/integration/test_ros_robots.py": "a server for each release of ROS and of the bridge",
    "tests/zensim/api/test_failures.py": "servers of their own, which are killed or cut off",
}
"""Files that may take longer, and why."""


class Outcome(TypedDict):
    """What became of a run of pytest."""

    status: int
    passed: list[str]
    failed: list[str]
    """Tests that failed, set-up, clean-up and crashed workers included."""
    is_whole: bool
    """Whether each test that was selected ran, and all could be listed."""
    durations: dict[str, list[float]]
    """Wall and processor seconds of each test."""


class Recorder:
    """Collects the ids of tests; of a run with workers, in the process that starts them."""

    def __init__(self) -> None:
        self._passed: dict[str, None] = {}
        self._failed: dict[str, None] = {}
        self._seen: set[str] = set()
        self._is_whole = True
        self._durations: dict[str, list[float]] = {}

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """Note that a file, or a worker, could not list its tests."""
        self._is_whole = self._is_whole and not report.failed

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note a test that failed in any phase, or passed."""
        self._seen.add(report.nodeid)
        spent = self._durations.setdefault(report.nodeid, [0.0, 0.0])
        spent[0] += report.duration
        spent[1] += getattr(report, "cpu_s", 0.0)
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
            durations=self._durations,
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
            return Outcome(status=status or 1, passed=[], failed=[], is_whole=False, durations={})
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


def sum_files(durations: dict[str, list[float]]) -> dict[str, list[float]]:
    """Sum wall and processor seconds by file."""
    files: dict[str, list[float]] = {}
    for test, (wall_s, cpu_s) in durations.items():
        spent = files.setdefault(test.partition("::")[0], [0.0, 0.0])
        spent[0] += wall_s
        spent[1] += cpu_s
    return files


def name_long_files(files: dict[str, list[float]]) -> bool:
    """Print the files that took much processor time; return whether one is above the limit."""
    share = float(os.environ.get(SHARE_VARIABLE, "inf"))
    limit_s = share * sum(cpu_s for _, cpu_s in files.values())
    is_above = False
    for file, (_, cpu_s) in sorted(files.items()):
        if cpu_s <= min(FILE_CPU_S, limit_s) or file in LONG_FILES:
            continue
        verdict = ""
        if cpu_s > limit_s:
            is_above = True
            verdict = f", above {limit_s:.1f} s: make it cheaper, or list it in .ci/run_tests.py"
        sys.stdout.write(f"{file} took {cpu_s:.1f} s of processor time{verdict}\n")
    return is_above


def write_durations(durations: dict[str, list[float]], files: dict[str, list[float]]) -> None:
    """Keep the seconds of each test, and print those of the slowest tests and files."""
    before = json.loads(DURATIONS.read_text()) if DURATIONS.exists() else {}
    DURATIONS.write_text(json.dumps({**before, **durations}, indent=0, sort_keys=True))
    for kind, seconds in (("tests", durations), ("files", files)):
        slowest = sorted(seconds.items(), key=lambda item: -item[1][0])[:SLOWEST]
        lines = [f"{wall_s:8.1f} {cpu_s:8.1f}  {name}\n" for name, (wall_s, cpu_s) in slowest]
        sys.stdout.write(f"slowest {kind} (seconds, of processor):\n{''.join(lines)}")
    sys.stdout.flush()


def main(arguments: list[str]) -> int:
    """Run the tests, and those that failed again."""
    PASSED_ALONE.parent.mkdir(exist_ok=True)
    PASSED_ALONE.touch()  # now, because a later run as root would own it
    first = run(arguments)
    files = sum_files(first["durations"])
    write_durations(first["durations"], files)
    if (is_above := name_long_files(files)) or not is_worth_another(first):
        sys.stdout.write("".join(f"failed: {test}\n" for test in first["failed"][:SLOWEST]))
        return first["status"] or int(is_above)
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
