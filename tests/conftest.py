"""How tests are shared out, how often property tests run, and Ctrl-C."""

import signal
from pathlib import Path

import pytest
from hypothesis import settings

# A shell in the background ignores Ctrl-C, and so would every process that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Cores are shared where tests run: how long one example takes says nothing.
settings.register_profile("commit", deadline=None)
settings.register_profile("fuzz", deadline=None, max_examples=5000)
settings.load_profile("commit")

SHARING = ("integration", "deploy", "spawner/cli")
"""Where the tests of a file share a server: side by side, each process would start its own."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Keep the tests together that share a server, for `--dist loadgroup`."""
    here = Path(__file__).parent
    folders = {here / folder for folder in SHARING}
    for item in items:
        if item.path.parent in folders:
            item.add_marker(pytest.mark.xdist_group(item.path.relative_to(here).as_posix()))
