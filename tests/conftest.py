"""Profiles of property tests; handling of Ctrl-C; log level; order of files; garbage collection."""

import gc
import logging
import signal
from collections.abc import Generator

import pytest
from hypothesis import settings

from zensim.proto.verbosity import LOG, set_verbosity

# Background shells ignore SIGINT, and child processes would inherit that.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Tests run on shared cores: the time of one example is not meaningful.
# A commit passes or fails the same way each time; `make fuzz` looks for new examples.
settings.register_profile("commit", deadline=None, derandomize=True)
settings.register_profile("fuzz", deadline=None, max_examples=5000)
settings.load_profile("commit")

LONG = ("tests/integration/", "tests/zensim/", "tests/spawner/cli/", "tests/contract/test_wheel.py")
"""Files that wait for processes: they come first, so that all workers end together."""


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
    """Put long files first; the order within a file stays."""
    items.sort(key=lambda item: not item.nodeid.startswith(LONG))


@pytest.fixture(autouse=True)
def usual_verbosity() -> None:
    """Undo what a command that ran in this process before chose."""
    LOG.setLevel(logging.NOTSET)
    set_verbosity(is_quiet=False, is_verbose=False, is_json=False)
