"""How property tests run, as often as a commit can bear or as `make fuzz` asks; and Ctrl-C."""

import signal

from hypothesis import settings

# A shell in the background ignores Ctrl-C, and so would every process that a test starts.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Cores are shared where tests run: how long one example takes says nothing.
settings.register_profile("commit", deadline=None)
settings.register_profile("fuzz", deadline=None, max_examples=5000)
settings.load_profile("commit")
