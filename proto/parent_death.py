"""Processes that end with their parent or supervisor, and who gets those without a parent."""

import ctypes
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Mapping

PARENT_PID_VARIABLE = "ZENSIM_PARENT"
"""Environment variable with the process id of the supervisor."""
PR_SET_PDEATHSIG, PR_SET_CHILD_SUBREAPER = 1, 36
PARENT_POLL_S = 0.5
SIGKILL = getattr(signal, "SIGKILL", signal.SIGTERM)
"""Signal that ends a process at once; Windows ends it so for any signal."""


def die_with_parent(signal_number: signal.Signals = SIGKILL, *, parent: int | None = None) -> None:
    """Send this process a signal when its parent ends.

    The kernel does it where prctl exists; elsewhere a thread looks twice a second. Windows does not
    report the end of a parent.

    Args:
        signal_number: To send.
        parent: Process id of the parent, if it is known.

    Raises:
        SystemExit: That parent has ended already.
    """
    prctl = _find_prctl()
    if prctl is not None:
        prctl(PR_SET_PDEATHSIG, signal_number, 0, 0, 0)
    else:
        threading.Thread(
            target=_await_orphanhood, args=(os.getppid(), signal_number), daemon=True
        ).start()
    # Its end before the call above sends nothing.
    if parent is not None and os.getppid() != parent:
        sys.exit(f"parent process {parent} has ended, so this one ends; see {PARENT_PID_VARIABLE}")


def set_subreaper(*, is_one: bool) -> None:
    """Let this process get the children of its descendants that end, or no longer; Linux only."""
    prctl = _find_prctl()
    if prctl is not None:
        prctl(PR_SET_CHILD_SUBREAPER, int(is_one), 0, 0, 0)


def _find_prctl() -> Callable[..., int] | None:
    return getattr(ctypes.CDLL(None), "prctl", None) if sys.platform == "linux" else None


def _await_orphanhood(parent: int, signal_number: signal.Signals) -> None:
    while os.getppid() == parent:
        time.sleep(PARENT_POLL_S)
    os.kill(os.getpid(), signal_number)


def die_with_supervisor(environ: Mapping[str, str]) -> None:
    """Terminate this process when the supervisor that the environment names ends.

    Raises:
        SystemExit: It has ended already.
    """
    parent = environ.get(PARENT_PID_VARIABLE, "")
    if not parent.isdigit():
        return
    die_with_parent(signal.SIGTERM, parent=int(parent))
