"""SHA-256 of the interpreter: `hashlib` loads OpenSSL, which takes 3.6 MB of each process."""

import sys
from collections.abc import Callable
from importlib import import_module
from typing import Protocol


class Digest(Protocol):
    """A hash of what was added so far."""

    def update(self, data: bytes, /) -> None:
        """Add bytes."""

    def digest(self) -> bytes:
        """Find the 32 bytes."""

    def hexdigest(self) -> str:
        """Find them as hexadecimal digits."""


def _find_sha256() -> Callable[[bytes], Digest]:
    try:
        found = import_module("_sha2" if sys.version_info >= (3, 12) else "_sha256")
    except ImportError:
        found = import_module("hashlib")
    hasher: Callable[[bytes], Digest] = found.sha256
    return hasher


sha256 = _find_sha256()
"""Hashes bytes; see `hashlib.sha256`."""
