"""Content-addressed files (sha256): uploads in chunks, generated meshes, eviction; their folder."""

from __future__ import annotations

import hashlib
import logging
import os
import re
import shutil
import tempfile
import time
import weakref
from collections import OrderedDict
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.messages.asset_messages import MAX_BUNDLE_FILES, MAX_CHUNK_BYTES, MAX_FILE_BYTES
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.process_limits import lock_file
from zensim.proto.stl import read_corners
from zensim.sim_server.errors import AssetRefused

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from hashlib import _Hash

    from numpy.typing import NDArray

LOG = logging.getLogger(__name__)
STORE_BUDGET_BYTES = 1 << 30
"""Bytes of all evictable files; the least recently used are evicted first."""
MAX_UNFINISHED = 512
MAX_CACHED_VERTICES = 256
"""Meshes whose vertices are kept in memory: 0.7 MB at most each, 7 kB for a hull."""
SHA256_PATTERN = re.compile(r"[0-9a-f]{64}")


SWEPT_AFTER_S = 60.0
"""Age of a temporary folder that no server holds: a new one is not locked yet."""


class AssetFolder:
    """A folder of one server, held by a locked descriptor, and made again if it was removed.

    While it is locked, other servers and systemd-tmpfiles leave a temporary folder alone.
    """

    def __init__(self, path: Path | None) -> None:
        """Make the folder empty.

        Args:
            path: Of no other server; None = a temporary one. Temporary ones of ended servers are
                removed.

        Raises:
            OSError: It cannot be written.
        """
        if path is None:
            path = _make_temporary_folder()
        elif path.exists():
            shutil.rmtree(path)
        self.path = path
        self._descriptor: int | None = None
        self._hold()

    def is_lost(self) -> bool:
        """Whether the path is not this folder any more."""
        if self._descriptor is None:
            return not self.path.is_dir()
        try:
            found = self.path.stat()
        except OSError:
            return True
        return not os.path.samestat(found, os.fstat(self._descriptor))

    def renew(self) -> None:
        """Make the folder again, empty."""
        self.close()
        self._hold()

    def open(self, name: str, flags: int) -> int:
        """Open a file; no path is followed."""
        if self._descriptor is None:
            return os.open(self.path / name, flags, 0o600)
        return os.open(name, flags, 0o600, dir_fd=self._descriptor)

    def write(self, name: str, data: bytes) -> None:
        """Write a whole file, or none."""
        try:
            self._write(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, data)
        except OSError:
            self.remove(name)
            raise

    def append(self, name: str, data: bytes) -> None:
        """Write at the end of a file."""
        self._write(name, os.O_WRONLY | os.O_CREAT | os.O_APPEND, data)

    def rename(self, name: str, new_name: str) -> None:
        """Rename a file."""
        (self.path / name).rename(self.path / new_name)

    def remove(self, name: str) -> None:
        """Remove a file if it can be removed."""
        with suppress(OSError):
            (self.path / name).unlink()

    def close(self) -> None:
        """Remove the folder."""
        self._discard()
        self._descriptor = None

    def _write(self, name: str, flags: int, data: bytes) -> None:
        with open(self.open(name, flags), "wb") as file:  # noqa: PTH123  by descriptor
            file.write(data)

    def _hold(self) -> None:
        self.path.mkdir(mode=0o700, parents=True, exist_ok=True)
        if hasattr(os, "O_DIRECTORY"):
            self._descriptor = os.open(self.path, os.O_RDONLY | os.O_DIRECTORY)
            with suppress(OSError):  # some file systems have no locks
                lock_file(self._descriptor)
        # Also when the store is dropped, and at the end of the process.
        self._discard: Callable[[], object] = weakref.finalize(
            self, _discard_folder, self.path, self._descriptor, os.getpid()
        )


def _discard_folder(path: Path, descriptor: int | None, process_id: int) -> None:
    """Remove a folder unless another is in its place; a fork of its process leaves it alone."""
    if os.getpid() != process_id:
        return
    if descriptor is None:
        shutil.rmtree(path, ignore_errors=True)
        return
    with suppress(OSError):
        if os.path.samestat(path.stat(), os.fstat(descriptor)):
            shutil.rmtree(path, ignore_errors=True)
    os.close(descriptor)


def _make_temporary_folder() -> Path:
    """Make a temporary folder beside those of this user's other servers; remove old ones."""
    if not hasattr(os, "getuid"):
        return Path(tempfile.mkdtemp(prefix="zensim-"))
    parent = Path(tempfile.gettempdir(), f"zensim-files-{os.getuid()}")
    parent.mkdir(mode=0o700, exist_ok=True)
    if parent.is_symlink() or parent.stat().st_uid != os.getuid():
        return Path(tempfile.mkdtemp(prefix="zensim-"))
    for path in parent.iterdir():
        with suppress(OSError):
            if time.time() - path.stat().st_mtime > SWEPT_AFTER_S:
                _remove_unless_held(path)
    return Path(tempfile.mkdtemp(dir=parent))


def _remove_unless_held(path: Path) -> None:
    """Remove a folder; raises OSError if a server holds it."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    try:
        lock_file(descriptor)
        shutil.rmtree(path, ignore_errors=True)
    finally:
        os.close(descriptor)


@dataclass
class _PartialFile:
    total: int
    received: int = 0
    digest: _Hash = field(default_factory=hashlib.sha256)


class AssetStore:
    """Uploaded files, and the meshes that were generated from them.

    Its methods raise AssetRefused with the slug `bundle.disk` if the disk refuses.
    """

    def __init__(
        self, budget_bytes: int = STORE_BUDGET_BYTES, *, folder: Path | None = None
    ) -> None:
        self._folder = AssetFolder(folder)
        self._budget_bytes = budget_bytes
        self._sizes: OrderedDict[str, int] = OrderedDict()
        self._pinned: dict[str, int] = {}
        self._evictable_bytes = 0
        self._unfinished: OrderedDict[str, _PartialFile] = OrderedDict()
        self._vertices: OrderedDict[str, NDArray[np.float32]] = OrderedDict()

    def __contains__(self, sha256: str) -> bool:
        """Whether the file is complete."""
        return sha256 in self._sizes or sha256 in self._pinned

    def missing(self, sha256s: Iterable[str]) -> list[tuple[str, int]]:
        """List the files that are incomplete, each with the number of its bytes that were received.

        Raises:
            AssetRefused: There are too many, or one is not a sha256.
        """
        self._forget_if_lost()
        wanted = dict.fromkeys(sha256s)
        if len(wanted) > MAX_BUNDLE_FILES:
            raise AssetRefused(
                f"{len(wanted)} files are too many; use {MAX_BUNDLE_FILES} or less",
                slug="bundle.files",
            )
        absent = [_check_sha256(sha256) for sha256 in wanted if sha256 not in self]
        partial = self._unfinished
        return [(name, partial[name].received if name in partial else 0) for name in absent]

    def put(self, sha256: str, *, offset: int, total: int, data: bytes) -> int:
        """Append a chunk to a file; a chunk that was received before has no effect.

        Returns:
            How many bytes from the start were received.

        Raises:
            AssetRefused: The chunk does not fit, or the complete file has another sha256.
        """
        _check_sha256(sha256)
        self._forget_if_lost()
        if sha256 in self:
            return self.size(sha256)
        self._check_chunk(sha256, offset, total, len(data))
        file = self._unfinished.setdefault(sha256, _PartialFile(total))
        if offset + len(data) <= file.received and data:
            return file.received
        self._append(sha256, file, data[file.received - offset :])
        if file.received == total:
            self._finish(sha256, file)
        return file.received

    def add(self, sha256: str, data: bytes) -> None:
        """Store a file that the server generated."""
        self._forget_if_lost()
        if sha256 not in self:
            self._write(sha256, data)
            self._add(sha256, len(data))

    def pin(self, sha256: str, data: bytes) -> None:
        """Store a file that is never evicted; it does not count in the budget."""
        self._forget_if_lost()
        if sha256 in self._sizes:
            self._evictable_bytes -= self._sizes.pop(sha256)
        self._write(sha256, data)
        self._pinned[sha256] = len(data)

    def pin_stored(self, sha256: str) -> None:
        """Never evict a stored file.

        Raises:
            AssetRefused: It is not stored.
        """
        size = self.size(sha256)
        if self._sizes.pop(sha256, None) is not None:
            self._evictable_bytes -= size
            self._pinned[sha256] = size

    def size(self, sha256: str) -> int:
        """Return the length of a file [bytes], and mark it as used.

        Raises:
            AssetRefused: It is not stored.
        """
        if sha256 in self._pinned:
            return self._pinned[sha256]
        if (size := self._sizes.get(sha256)) is None:
            raise AssetRefused(
                f"file {sha256[:80]!r} is not stored; send it by put_asset",
                slug="bundle.unknown",
                code=ResultCode.NOT_FOUND,
            )
        self._sizes.move_to_end(sha256)
        return size

    def read(self, sha256: str, offset: int, max_bytes: int) -> bytes:
        """Read a part of a file.

        Raises:
            AssetRefused: It is not stored, or is shorter.
        """
        if offset > (size := self.size(sha256)):
            raise AssetRefused(
                f"offset {offset} is beyond the file's {size} bytes", slug="bundle.offset"
            )
        with (
            self._forgetting(sha256),
            open(  # noqa: PTH123  by descriptor
                self._folder.open(_file_name(sha256), os.O_RDONLY), "rb"
            ) as file,
        ):
            file.seek(offset)
            return file.read(max_bytes)

    def vertices(self, sha256: str) -> NDArray[np.float32]:
        """Read the distinct vertices (n, 3) of a generated mesh; they are cached.

        Raises:
            AssetRefused: It is not stored.
        """
        if (found := self._vertices.get(sha256)) is None:
            found = self._vertices[sha256] = _drop_repeated(read_corners(self.read(sha256, 0, -1)))
        self._vertices.move_to_end(sha256)
        while len(self._vertices) > MAX_CACHED_VERTICES:
            self._vertices.popitem(last=False)
        return found

    def corners(self, sha256: str) -> NDArray[np.float32]:
        """Read the corners (3 f, 3) of the triangles of a generated mesh.

        Raises:
            AssetRefused: It is not stored.
        """
        return read_corners(self.read(sha256, 0, -1))

    @property
    def folder(self) -> str:
        """Folder of the files, named `<sha256>.stl`."""
        return str(self._folder.path)

    def close(self) -> None:
        """Remove the folder."""
        self._folder.close()

    def _forget_if_lost(self) -> None:
        """Make the folder again if it was removed; clients send its files again."""
        if not self._folder.is_lost():
            return
        LOG.warning("asset folder %s was removed; it is made again, empty", self._folder.path)
        with _refusing():
            self._folder.renew()
        for files in (self._sizes, self._pinned, self._unfinished, self._vertices):
            files.clear()
        self._evictable_bytes = 0

    @contextmanager
    def _forgetting(self, sha256: str) -> Iterator[None]:
        """Forget a file that cannot be read; clients send it again."""
        try:
            with _refusing():
                yield
        except AssetRefused:
            self._evictable_bytes -= self._sizes.pop(sha256, 0)
            self._pinned.pop(sha256, None)
            raise

    def _write(self, sha256: str, data: bytes) -> None:
        with _refusing():
            self._folder.write(_file_name(sha256), data)

    def _check_chunk(self, sha256: str, offset: int, total: int, length: int) -> None:
        if not 0 < total <= MAX_FILE_BYTES:
            raise AssetRefused(
                f"a file of {total} bytes; use 1 to {MAX_FILE_BYTES} bytes", slug="bundle.size"
            )
        if length > MAX_CHUNK_BYTES:
            raise AssetRefused(
                f"a chunk of {length} bytes; send at most {MAX_CHUNK_BYTES}", slug="bundle.chunk"
            )
        known = self._unfinished.get(sha256) or _PartialFile(total)
        if total != known.total or offset + length > total:
            raise AssetRefused(
                f"bytes {offset} to {offset + length} of {total}, but the file has {known.total}",
                slug="bundle.total",
            )
        if offset > known.received:
            raise AssetRefused(
                f"offset {offset} leaves a gap; continue at {known.received}", slug="bundle.offset"
            )

    def _append(self, sha256: str, file: _PartialFile, data: bytes) -> None:
        try:
            with _refusing():
                self._folder.append(f"{sha256}.part", data)
        except AssetRefused:
            # It is not known how much was written.
            self._drop_unfinished(sha256)
            raise
        file.digest.update(data)
        file.received += len(data)
        self._unfinished.move_to_end(sha256)
        while (
            len(self._unfinished) > MAX_UNFINISHED or self._unfinished_bytes() > STORE_BUDGET_BYTES
        ):
            self._drop_unfinished(next(iter(self._unfinished)))

    def _unfinished_bytes(self) -> int:
        return sum(file.received for file in self._unfinished.values())

    def _finish(self, sha256: str, file: _PartialFile) -> None:
        if (found := file.digest.hexdigest()) != sha256:
            self._drop_unfinished(sha256)
            raise AssetRefused(
                f"the file sent as {sha256} is {found}; send it again from 0", slug="bundle.sha256"
            )
        del self._unfinished[sha256]
        with _refusing():
            self._folder.rename(f"{sha256}.part", _file_name(sha256))
        self._add(sha256, file.total)

    def _drop_unfinished(self, sha256: str) -> None:
        del self._unfinished[sha256]
        self._folder.remove(f"{sha256}.part")

    def _add(self, sha256: str, size: int) -> None:
        self._sizes[sha256] = size
        self._evictable_bytes += size
        while self._evictable_bytes > self._budget_bytes and len(self._sizes) > 1:
            oldest, freed = self._sizes.popitem(last=False)
            self._evictable_bytes -= freed
            self._folder.remove(_file_name(oldest))


def _file_name(sha256: str) -> str:
    # Engines recognize a mesh by its suffix.
    return f"{sha256}.stl"


@contextmanager
def _refusing() -> Iterator[None]:
    """Turn an error of the disk into a refusal, and log it."""
    try:
        yield
    except OSError as error:
        LOG.warning("asset folder error=%s", error)
        raise AssetRefused(
            f"the server's folder of files cannot be used: {error.strerror}; "
            "make room on its disk, or send the files again",
            slug="bundle.disk",
        ) from error


def _drop_repeated(vertices: NDArray[np.float32]) -> NDArray[np.float32]:
    """Drop repeated vertices: a vertex is shared by six triangles as a rule."""
    rows = np.ascontiguousarray(vertices).view(np.dtype((np.void, 3 * vertices.itemsize)))
    return np.unique(rows).view(np.float32).reshape(-1, 3)


def _check_sha256(sha256: str) -> str:
    if SHA256_PATTERN.fullmatch(sha256) is None:
        raise AssetRefused(
            f"{sha256[:80]!r} is not a sha256; use 64 lower-case hexadecimal digits",
            slug="bundle.name",
        )
    return sha256
