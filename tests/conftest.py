"""Profiles of property tests; what each test finds as it was; which files are read; their order."""

import gc
import logging
import os
import signal
from collections.abc import Generator, Sequence
from pathlib import Path

import pytest
from hypothesis import settings

from tests.integration import fork_server
from zensim.proto.stop_signal import STOP_SIGNALS
from zensim.proto.verbosity import LOG, set_verbosity

# Background shells ignore SIGINT, and child processes would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests run on shared cores: the time of one example is not meaningful.
# A commit passes or fails the same way each time; `make fuzz` looks for new examples.
settings.register_profile("commit", deadline=None, derandomize=True)
settings.register_profile("fuzz", deadline=None, max_examples=1000)
settings.load_profile("commit")

ROOT = Path(__file__).parents[1]
WAITING = (
    *("tests/integration/", "tests/zensim/", "tests/deploy/"),
    *("tests/mutation/", "tests/contract/test_wheel.py"),
)
"""Files whose tests mostly wait for processes."""
LAST_SHARE = 0.3
"""Of the other files: they come last, so that all workers end together."""
LONG = (
    *("tests/integration/test_view.py", "tests/benchmarks/test_benchmarks.py"),
    *("tests/chaos/test_chaos.py", "tests/hostile/test_server_fuzz.py"),
)
"""Files with the longest tests of `make browser` and `make short`: they come first."""
TOOLS = (
    *("tests/mutation/", "tests/chaos/test_history.py", "tests/benchmarks/"),
    *("tests/hostile/test_coverage_fuzz.py", "tests/deploy/sweep/test_ray_runs.py"),
    "tests/zensim/envs/test_ray_sampling.py",
    *("tests/contract/test_wheel.py", "tests/contract/test_workflows.py"),
    *("tests/contract/test_benchmark_page.py", "tests/contract/test_reliability_page.py"),
    *("tests/contract/test_platforms.py", "tests/contract/test_run_tests.py"),
    "tests/integration/test_tasks.py",
)
"""Files that test the tools of the project, or start a cluster of Ray."""
WHOLE_PROGRAMS = (
    *(
        f"tests/integration/test_{name}.py"
        for name in (
            *("check", "compose_commands", "doctor", "failed_engine", "foxglove", "joint_efforts"),
            *("learning_example", "leaving_clients", "page_random_use", "parser_failures"),
            *("recorded_files", "restore_state", "ros_domains", "teleop", "top"),
            *("up_endings", "up_others", "up_scenario", "vda5050_vehicles"),
        )
    ),
    *("tests/deploy/test_fleet_demo.py", "tests/deploy/test_scenario_process.py"),
    *("tests/deploy/test_sweep_commands.py", "tests/zensim/test_testing.py"),
    *(f"tests/zensim/api/test_{name}.py" for name in ("notebook", "program_keeper", "scripts")),
)
"""Files that run whole programs for minutes, a quarter of all tests; on each push there are tests
of the parts of each, and others that run programs."""
NIGHTLY = (*TOOLS, *WHOLE_PROGRAMS)
"""Files of `make release`; tests that need Chromium or root must not be in them."""
WRITTEN_MARKS = frozenset(
    {"root", "browser", "short_form", "long_form", "interop", "images", "smoke"}
)
"""Each is written in the files of its tests; tests/contract/test_selection.py checks that."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files without a mark that every selected test has: to import all takes a minute."""
    expression = config.getoption("markexpr")
    if collection_path.suffix != ".py":
        return None
    if is_left_out_for_release(collection_path, expression):
        return True
    marks = find_required_marks(expression)
    if not marks:
        return None
    text = collection_path.read_text(encoding="utf-8")
    return True if any(f"mark.{mark}" not in text for mark in marks) else None


def is_left_out_for_release(path: Path, expression: str) -> bool:
    """Whether `-m` selects by the mark `release`, and leaves a file out."""
    terms = [] if "(" in expression or " or " in expression else expression.split(" and ")
    is_of_release = is_nightly(path)
    is_test = path.name.startswith("test_")
    return (is_of_release and "not release" in terms) or (
        is_test and not is_of_release and "release" in terms
    )


def is_nightly(path: Path) -> bool:
    """Whether a file is among those of `make release`."""
    return path.is_relative_to(ROOT) and path.relative_to(ROOT).as_posix().startswith(NIGHTLY)


def find_required_marks(expression: str) -> list[str]:
    """Find the written marks that each test has which `-m` selects."""
    if "(" in expression or " or " in expression:
        return []
    return [term for term in expression.split(" and ") if term in WRITTEN_MARKS]


def pytest_itemcollected(item: pytest.Item) -> None:
    """Mark the tests of the files of `make release`."""
    if is_nightly(item.path):
        item.add_marker("release")


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Generator[None, object, object]:
    """Leave tests and modules out of garbage collection: they stay to the end."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Spread the files that wait among those that compute; the order within a file stays."""
    places = find_places([item.nodeid.partition("::")[0] for item in items])
    items.sort(key=lambda item: places[item.nodeid.partition("::")[0]])


def find_places(files: Sequence[str]) -> dict[str, float]:
    """Find the place of each file in a run, -1 to 1; both kinds are mixed until the last."""
    kinds: tuple[list[str], list[str]] = ([], [])
    for file in dict.fromkeys(files):
        kinds[file.startswith(WAITING)].append(file)
    computing, waiting = kinds
    places = {file: (1.0 - LAST_SHARE) * n / len(waiting) for n, file in enumerate(waiting)}
    places |= {file: n / len(computing) for n, file in enumerate(computing)}
    return places | dict.fromkeys(places.keys() & LONG, -1.0)


def find_cpu_time_s() -> float:
    """Find the processor time of this process and of the programs that ended."""
    spent = os.times()
    children_s = spent.children_user + spent.children_system
    return spent.user + spent.system + children_s + fork_server.find_cpu_time_s()


MADE_BY_TOOLS = (".", "__pycache__", "build", "dist", "zensim.egg-info")
REPORTED_CPU_S = [find_cpu_time_s()]
"""Of this process, at its last report."""


def pytest_runtest_logstart() -> None:
    """Leave out what passed between two tests."""
    REPORTED_CPU_S[:] = [find_cpu_time_s()]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Add the processor time of each phase, which .ci/run_tests.py records."""
    report = yield
    now_s = find_cpu_time_s()
    vars(report)["cpu_s"] = now_s - REPORTED_CPU_S.pop()
    REPORTED_CPU_S.append(now_s)
    return report


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(nextitem: pytest.Item | None) -> Generator[None, object, object]:
    """Count what all files share, as the server of a worker, for none: it ends with the last."""
    if nextitem is not None:
        return (yield)
    before_s = find_cpu_time_s()
    try:
        return (yield)
    finally:
        REPORTED_CPU_S.append(REPORTED_CPU_S.pop() + find_cpu_time_s() - before_s)


@pytest.fixture(scope="module", autouse=True)
def usual_checkout() -> Generator[None]:
    """Fail the file whose tests leave something in the root of the checkout."""
    before = set(ROOT.iterdir())
    yield
    left = set(ROOT.iterdir()) - before
    assert [path for path in left if not path.name.startswith(MADE_BY_TOOLS)] == []


@pytest.fixture(autouse=True)
def usual_signals() -> Generator[None]:
    """Restore the handlers of signals that a command replaces which runs in this process."""
    before = [(number, signal.getsignal(number)) for number in STOP_SIGNALS]
    yield
    for number, handler in before:
        if handler is not None:  # None: the handler is not a Python function
            signal.signal(number, handler)


@pytest.fixture(autouse=True)
def usual_environment() -> Generator[None]:
    """Restore variables of the environment that a command changes which runs in this process."""
    before = dict(os.environ)
    yield
    before["PYTEST_CURRENT_TEST"] = os.environ["PYTEST_CURRENT_TEST"]  # names the phase of the test
    for name in os.environ.keys() - before.keys():
        del os.environ[name]
    os.environ.update({name: text for name, text in before.items() if os.environ.get(name) != text})


@pytest.fixture(autouse=True)
def usual_verbosity() -> None:
    """Undo what a command that ran in this process before chose."""
    LOG.setLevel(logging.NOTSET)
    set_verbosity(is_quiet=False, is_verbose=False, is_json=False)
