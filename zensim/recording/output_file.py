"""A file that is appended to in whole pieces, with disk space in reserve for its end."""

import errno
import os
from contextlib import suppress
from pathlib import Path
from typing import Final

RESERVE_STEP_BYTES: Final = 1 << 20


def find_reserve(path: Path) -> Path:
    """Find the file whose space is kept for the end of a file; it has a name where it must."""
    return path.with_name(f".{path.name}.reserve")


class OutputFile:
    """A file to which each write appends all bytes, or none."""

    def __init__(self, path: Path, *, is_synchronous: bool = False) -> None:
        """Create the file.

        Args:
            path: Must not exist.
            is_synchronous: Whether each write waits until the disk has the bytes.

        Raises:
            OSError: It exists, or cannot be created.
        """
        self.path = path
        self.position = 0
        self._is_synchronous = is_synchronous
        self._reserve_path = find_reserve(path)
        self._reserve = -1
        """Descriptor of the reserve. It has no name: its space is free when this process ends."""
        self._reserve_bytes = 0
        self._descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)

    def write(self, content: bytes) -> None:
        """Append all bytes, or none.

        Raises:
            OSError: None were appended, such as where the disk is full.
        """
        left = memoryview(content)
        try:
            while left:
                # A disk that is nearly full takes a part without an error.
                left = left[os.write(self._descriptor, left) :]
            if self._is_synchronous:
                os.fdatasync(self._descriptor)
        except OSError:
            self._cut()
            raise
        self.position += len(content)

    def reserve(self, count: int) -> None:
        """Keep at least this number of bytes of the disk until `release`.

        Raises:
            OSError: The disk is full.
        """
        wanted = -(-count // RESERVE_STEP_BYTES) * RESERVE_STEP_BYTES
        if wanted <= self._reserve_bytes:
            return
        if self._reserve < 0:
            self._reserve = os.open(self._reserve_path, os.O_WRONLY | os.O_CREAT, 0o600)
            with suppress(PermissionError):  # Windows removes no file that is open
                self._reserve_path.unlink()
        try:
            _allocate(self._reserve, wanted)
        except OSError as error:
            # The call has no name of a file.
            raise OSError(error.errno, error.strerror, str(self._reserve_path.parent)) from error
        self._reserve_bytes = wanted

    def release(self) -> None:
        """Free what is reserved."""
        if self._reserve >= 0:
            os.close(self._reserve)
            self._reserve_path.unlink(missing_ok=True)
        self._reserve, self._reserve_bytes = -1, 0

    def close(self) -> None:
        """Free what is reserved, and close the file."""
        self.release()
        os.close(self._descriptor)

    def _cut(self) -> None:
        os.ftruncate(self._descriptor, self.position)
        os.lseek(self._descriptor, self.position, os.SEEK_SET)


def _allocate(descriptor: int, count: int) -> None:
    if hasattr(os, "posix_fallocate"):
        try:
            os.posix_fallocate(descriptor, 0, count)
        except OSError as error:
            if error.errno not in (errno.EOPNOTSUPP, errno.EINVAL):
                raise
        else:
            return
    os.lseek(descriptor, 0, os.SEEK_SET)
    left = count
    while left > 0:
        left -= os.write(descriptor, bytes(min(left, RESERVE_STEP_BYTES)))
