"""Threads and log of Zenoh in this process."""

import os
from typing import Final

import zenoh

from zensim.proto.bus.bus_errors import ForkedProcess

HANDSHAKES: Final = "off,zenoh_transport::unicast::establishment::accept=debug,zenoh_link_tls=debug"


class RuntimeThreads:
    """Whether the threads of Zenoh, which the first session starts, are in this process.

    Attributes:
        are_started: Whether a session was opened, here or in a process that this one is a fork of.
        are_lost: Whether that was before the fork.
    """

    def __init__(self) -> None:
        self.are_started = self.are_lost = False
        if hasattr(os, "register_at_fork"):
            os.register_at_fork(after_in_child=self._note_fork)

    def _note_fork(self) -> None:
        self.are_lost = self.are_started


RUNTIME_THREADS = RuntimeThreads()


def require_threads() -> None:
    """Check that this process can open a session: Zenoh would wait for ever.

    Raises:
        ForkedProcess: It was forked after one was opened.
    """
    if RUNTIME_THREADS.are_lost:
        raise ForkedProcess


def log_handshakes() -> None:
    """Print how each session joins this process, a router, to standard output; RUST_LOG adds more.

    Zenoh reports the reason of a refusal in its log only.
    """
    zenoh.init_log_from_env_or(HANDSHAKES)
