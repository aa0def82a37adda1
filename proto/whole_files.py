"""Files that have their name only when all of their content is on the disk."""

import os
import re
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from secrets import token_hex
from typing import BinaryIO, Final

from zensim.proto.process_limits import sync_folder

TOKEN_BYTES: Final = 8
UNFINISHED: Final = re.compile(rf"\..+\.[0-9a-f]{{{2 * TOKEN_BYTES}}}\.part")
"""Names of files that are being written."""
ABANDONED_AFTER_S: Final = 3600.0
"""Wall time since the last change; writing a file takes seconds."""


@contextmanager
def writing_whole(file: Path, *, mode: int = 0o666) -> Iterator[BinaryIO]:
    """Write a file beside another, which it replaces at the end of the block.

    Processes may write the same file: the last one wins. Nothing is left if the block raises.

    Args:
        file: To replace, or to make.
        mode: Its permissions, without those of the umask.

    Raises:
        OSError: It cannot be written.
    """
    part = file.with_name(f".{file.name}.{token_hex(TOKEN_BYTES)}.part")
    descriptor = os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, mode)
    try:
        with os.fdopen(descriptor, "wb") as stream:
            yield stream
            stream.flush()
            os.fsync(stream.fileno())
        part.replace(file)
    finally:
        part.unlink(missing_ok=True)
    sync_folder(file.parent)


def remove_abandoned(folder: Path) -> None:
    """Remove what processes began to write and never finished, as they were killed.

    Raises:
        OSError: A file cannot be removed.
    """
    for one in folder.iterdir():
        if not UNFINISHED.fullmatch(one.name):
            continue
        try:
            age_s = time.time() - one.stat().st_mtime
        except FileNotFoundError:  # it was finished
            continue
        if age_s > ABANDONED_AFTER_S:
            one.unlink(missing_ok=True)
