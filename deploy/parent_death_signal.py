"""End this process when the supervisor has ended, even when the supervisor was killed."""

import ctypes
import os
import signal
import sys
from collections.abc import Mapping

PARENT_PID_VARIABLE = "ZENSIM_PARENT"
PR_SET_PDEATHSIG = 1


def die_with_parent(environ: Mapping[str, str]) -> None:
    """Ask the kernel to end this process when the supervisor named in the environment is gone."""
    parent = environ.get(PARENT_PID_VARIABLE, "")
    if not parent.isdigit() or sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM, 0, 0, 0)
    if os.getppid() != int(parent):
        sys.exit(1)
