"""The script that runs the tests gives those that depend on load a second run, and names them."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.contract.repository import ROOT

SCRIPT = ROOT / ".ci" / "run_tests.py"
WORKERS = ("-n", "2", "--dist", "loadfile")
PASSES = "def test_passes(): pass\n"
FAILS_ONCE = """
from pathlib import Path
def test_fails_once():
    seen = Path("seen")
    is_first = not seen.exists()
    seen.touch()
    assert not is_first
"""
CRASHES_ONCE = FAILS_ONCE.replace("assert not is_first", "if is_first: __import__('os')._exit(3)")
FAILS_TO_CLEAN_UP_ONCE = f"""
import pytest
{FAILS_ONCE.replace("def test_fails_once()", "def fail_once()")}
@pytest.fixture
def server():
    yield
    fail_once()
def test_fails_once(server): pass
"""
FAILS_ALWAYS = "def test_fails_always(): assert False\n"
CANNOT_BE_LISTED_ONCE = FAILS_ONCE + "test_fails_once()\n"
NAME = "test_b.py::test_fails_once"


TAKES_A_SECOND = """
import pytest
@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport():
    report = yield
    report.cpu_s = 1.0
    return report
"""


def run_tests(
    folder: Path, files: dict[str, str], *options: str, **environment: str
) -> "subprocess.CompletedProcess[str]":
    """Run a suite of its own, without what this run of pytest set."""
    (folder / "pytest.ini").write_text("[pytest]\naddopts = -p xdist -p no:cacheprovider\n")
    for name, text in {"test_a.py": PASSES, **files}.items():
        (folder / name).write_text(text)
    return subprocess.run(
        [sys.executable, "-B", str(SCRIPT), *options],
        cwd=folder,
        env={"PATH": "/usr/bin:/bin", "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1", **environment},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        check=False,
    )


def names_that_passed_alone(folder: Path) -> list[str]:
    return (folder / "build" / "passed_alone.txt").read_text().split()


@pytest.mark.parametrize("options", [(), WORKERS], ids=["alone", "workers"])
@pytest.mark.parametrize("text", [FAILS_ONCE, FAILS_TO_CLEAN_UP_ONCE], ids=["call", "clean-up"])
def test_run_passes_and_names_the_test_when_it_passes_alone(
    tmp_path: Path, text: str, options: tuple[str, ...]
) -> None:
    done = run_tests(tmp_path, {"test_b.py": text}, *options)

    assert done.returncode == 0, done.stdout
    assert done.stdout.endswith(f"{NAME}\n")
    assert names_that_passed_alone(tmp_path) == [NAME]


def test_run_passes_when_a_worker_crashed_and_the_test_passes_alone(tmp_path: Path) -> None:
    done = run_tests(tmp_path, {"test_b.py": CRASHES_ONCE + PASSES}, *WORKERS)

    assert done.returncode == 0, done.stdout
    assert names_that_passed_alone(tmp_path) == [NAME]


def test_run_fails_when_a_test_fails_twice(tmp_path: Path) -> None:
    files = {"test_b.py": FAILS_ONCE, "test_c.py": FAILS_ALWAYS}

    done = run_tests(tmp_path, files, *WORKERS)

    assert done.returncode == pytest.ExitCode.TESTS_FAILED
    assert done.stdout.count("def test_fails_always") == 2, done.stdout
    assert names_that_passed_alone(tmp_path) == [NAME]


def test_run_fails_without_a_second_run_when_six_tests_fail(tmp_path: Path) -> None:
    six = "import pytest\n@pytest.mark.parametrize('n', range(6))\ndef test_n(n): assert False\n"

    done = run_tests(tmp_path, {"test_b.py": six}, *WORKERS)

    assert done.returncode == pytest.ExitCode.TESTS_FAILED
    assert done.stdout.count("6 failed") == 1, done.stdout
    assert done.stdout.endswith("failed: test_b.py::test_n[5]\n")
    assert names_that_passed_alone(tmp_path) == []


@pytest.mark.parametrize("options", [(), WORKERS], ids=["alone", "workers"])
def test_run_fails_without_a_second_run_when_tests_cannot_be_listed(
    tmp_path: Path, options: tuple[str, ...]
) -> None:
    done = run_tests(tmp_path, {"test_b.py": CANNOT_BE_LISTED_ONCE}, *options)

    assert done.returncode != 0, done.stdout
    assert names_that_passed_alone(tmp_path) == []


def test_run_fails_without_a_second_run_when_tests_were_left_out(tmp_path: Path) -> None:
    done = run_tests(tmp_path, {"test_0.py": FAILS_ONCE}, "--maxfail", "1")

    assert done.returncode != 0, done.stdout
    assert names_that_passed_alone(tmp_path) == []


def test_run_keeps_the_exit_status_of_pytest_when_no_test_ran(tmp_path: Path) -> None:
    done = run_tests(tmp_path, {}, "-k", "none", *WORKERS)

    assert done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED, done.stdout


def test_run_keeps_the_exit_status_of_pytest_when_an_option_is_unknown(tmp_path: Path) -> None:
    done = run_tests(tmp_path, {}, "--no-such-option")

    assert done.returncode == pytest.ExitCode.USAGE_ERROR, done.stdout


def test_run_passes_once_when_nothing_fails(tmp_path: Path) -> None:
    done = run_tests(tmp_path, {}, *WORKERS)

    assert done.returncode == 0, done.stdout
    assert done.stdout.count("1 passed") == 1


@pytest.mark.parametrize("options", [(), WORKERS], ids=["alone", "workers"])
def test_run_keeps_the_seconds_of_tests_and_names_the_slowest(
    tmp_path: Path, options: tuple[str, ...]
) -> None:
    run_tests(tmp_path, {}, *options)
    done = run_tests(tmp_path, {"test_b.py": PASSES}, *options, "--deselect", "test_a.py")

    kept = json.loads((tmp_path / "build" / "test_durations.json").read_text())
    assert list(kept) == ["test_a.py::test_passes", "test_b.py::test_passes"]
    assert all(len(seconds) == 2 for seconds in kept.values())
    assert done.stdout.count("test_b.py::test_passes\n") == 1, done.stdout
    assert "test_a.py" not in done.stdout.partition("slowest")[2]


@pytest.mark.parametrize(("share", "status"), [("0.55", 1), ("0.65", 0)])
def test_file_fails_a_run_of_ci_when_it_takes_more_of_the_processor_time_than_its_share(
    tmp_path: Path, share: str, status: int
) -> None:
    three = "import pytest\n@pytest.mark.parametrize('n', range(3))\ndef test_n(n): pass\n"
    files = {"conftest.py": TAKES_A_SECOND, "test_b.py": three, "test_c.py": PASSES}

    done = run_tests(tmp_path, files, FILE_CPU_SHARE=share)

    assert done.returncode == status, done.stdout  # 9 s of 15: set-up, call and clean-up
    assert ("test_b.py took 9.0 s" in done.stdout) == bool(status)
    assert "test_a.py took" not in done.stdout


def test_listed_long_files_exist() -> None:
    listed = re.findall(r'^    "(tests/.*\.py)": ', SCRIPT.read_text(), re.MULTILINE)

    assert len(listed) >= 1
    assert [file for file in listed if not (ROOT / file).exists()] == []
