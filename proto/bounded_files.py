"""Reading of files that others wrote: regular ones only, and none beyond its limit.

A pipe, a device or a file that grows would keep a reader waiting, or fill its memory. Every file of
a user is read here (`tests/contract/test_bounded_files.py`).
"""

import errno
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, Final

PIECE_BYTES: Final = 1 << 20
MAX_TEXT_FILE_BYTES: Final = 4_000_000
"""Largest text that people write: settings, scenarios, poses, lists."""
MAX_OWN_FILE_BYTES: Final = 64 << 20
"""Largest file that zensim wrote, such as the rows of a sweep."""
OPEN_FLAGS: Final = (
    os.O_RDONLY
    | getattr(os, "O_NONBLOCK", 0)
    | getattr(os, "O_CLOEXEC", 0)
    | getattr(os, "O_BINARY", 0)
)
"""Flags that do not wait: opening a pipe would wait for a writer."""


class FileTooLarge(OSError):
    """A file has more bytes than its reader takes."""

    slug = "file.size"

    def __init__(self, path: Path, max_bytes: int) -> None:
        super().__init__(
            errno.EFBIG, f"has more than {max_bytes} bytes; make it smaller", str(path)
        )


class NotRegularFile(OSError):
    """A path names a pipe, a device or a socket."""

    slug = "file.kind"

    def __init__(self, path: Path) -> None:
        reason = "is a pipe, a device or a socket; give a regular file"
        super().__init__(errno.EINVAL, reason, str(path))


def open_regular_file(path: Path) -> BinaryIO:
    """Open a file to read, without waiting for anything.

    Raises:
        OSError: It cannot be opened, or is a folder.
        NotRegularFile: It is anything else but a regular file.
        ValueError: No path has this name.
    """
    descriptor = os.open(path, OPEN_FLAGS)
    mode = os.fstat(descriptor).st_mode
    if stat.S_ISREG(mode):
        return os.fdopen(descriptor, "rb")
    os.close(descriptor)
    if stat.S_ISDIR(mode):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    raise NotRegularFile(path)


def read_file(path: Path, max_bytes: int, on_piece: Callable[[], None] = lambda: None) -> bytes:
    """Read a file of limited size, which is checked before anything is read.

    Args:
        path: File.
        max_bytes: Most that it may have.
        on_piece: Called after each piece.

    Raises:
        OSError: See `open_regular_file`.
        FileTooLarge: It has more bytes.
    """
    data = bytearray()
    with open_regular_file(path) as stream:
        if os.fstat(stream.fileno()).st_size > max_bytes:
            raise FileTooLarge(path, max_bytes)
        while piece := stream.read(PIECE_BYTES):  # it may have grown; files of /proc have no size
            data += piece
            on_piece()
            if len(data) > max_bytes:
                raise FileTooLarge(path, max_bytes)
    return bytes(data)


def read_text_file(
    path: Path, max_bytes: int = MAX_TEXT_FILE_BYTES, *, encoding: str = "utf-8"
) -> str:
    r"""Read a text of limited size; line ends become `\n`.

    Raises:
        OSError: See `read_file`.
        UnicodeDecodeError: It is not text in this encoding.
    """
    text = read_file(path, max_bytes).decode(encoding)
    return text.replace("\r\n", "\n").replace("\r", "\n")


def read_pieces(path: Path) -> Iterator[bytes]:
    """Read a file of any size in pieces of limited size.

    Raises:
        OSError: See `open_regular_file`.
    """
    with open_regular_file(path) as stream:
        while piece := stream.read(PIECE_BYTES):
            yield piece


def hash_file(path: Path) -> tuple[str, int]:
    """Find the SHA-256 of a file, in hexadecimal digits, and its size [bytes].

    Raises:
        OSError: See `open_regular_file`.
    """
    # OpenSSL, which takes 3.6 MB to load, is three times as fast.
    import hashlib  # noqa: PLC0415

    digest, size = hashlib.sha256(), 0
    for piece in read_pieces(path):
        digest.update(piece)
        size += len(piece)
    return digest.hexdigest(), size
