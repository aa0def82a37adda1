"""Profiles of property tests; what each test finds as it was; which files are read; their order."""

import gc
import logging
import os
import signal
from collections.abc import Generator, Sequence
from pathlib import Path

import pytest
from hypothesis import settings

from zensim.proto.stop_signal import STOP_SIGNALS
from zensim.proto.verbosity import LOG, set_verbosity

# Background shells ignore SIGINT, and child processes would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests run on shared cores: the time of one example is not meaningful.
# A commit passes or fails the same way each time; `make fuzz` looks for new examples.
settings.register_profile("commit", deadline=None, derandomize=True)
settings.register_profile("fuzz", deadline=None, max_examples=5000)
settings.load_profile("commit")

WAITING = (
    *("tests/integration/", "tests/zensim/", "tests/spawner/cli/", "tests/deploy/"),
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
WRITTEN_MARKS = frozenset({"root", "browser", "short_form", "long_form", "interop", "images"})
"""Each is written in the files of its tests; tests/contract/test_selection.py checks that."""


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files without a mark that every selected test has: to import all takes a minute."""
    marks = find_required_marks(config.getoption("markexpr"))
    if not marks or collection_path.suffix != ".py":
        return None
    text = collection_path.read_text(encoding="utf-8")
    return True if any(f"mark.{mark}" not in text for mark in marks) else None


def find_required_marks(expression: str) -> list[str]:
    """Find the written marks that each test has which `-m` selects."""
    if "(" in expression or " or " in expression:
        return []
    return [term for term in expression.split(" and ") if term in WRITTEN_MARKS]


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
