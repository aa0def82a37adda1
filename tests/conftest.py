"""Profiles of property tests for commits and `make fuzz`; handling of Ctrl-C; log level."""

import logging
import signal

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


@pytest.fixture(autouse=True)
def usual_verbosity() -> None:
    """Undo what a command that ran in this process before chose."""
    LOG.setLevel(logging.NOTSET)
    set_verbosity(is_quiet=False, is_verbose=False, is_json=False)
