"""Discards what C code prints."""

import ctypes
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager

OUTPUT_STREAMS = (1, 2)
C_LIBRARY = None if os.name == "posix" else "ucrtbase"
"""Name of the C library; None = that of the interpreter."""


@contextmanager
def suppress_output() -> Iterator[None]:
    """Discard what C code prints on stdout and stderr."""
    libc = ctypes.CDLL(C_LIBRARY)
    sys.stdout.flush()
    sys.stderr.flush()
    libc.fflush(None)
    copies = [os.dup(stream) for stream in OUTPUT_STREAMS]
    null = os.open(os.devnull, os.O_WRONLY)
    for stream in OUTPUT_STREAMS:
        os.dup2(null, stream)
    try:
        yield
    finally:
        libc.fflush(None)
        for stream, copy in zip(OUTPUT_STREAMS, copies, strict=True):
            os.dup2(copy, stream)
            os.close(copy)
        os.close(null)
