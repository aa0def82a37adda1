"""Content-addressed files (sha256): uploads in chunks, generated meshes, eviction."""

from __future__ import annotations

import hashlib
import re
import shutil
import tempfile
from collections import OrderedDict
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from zensim.proto.messages.asset_messages import MAX_BUNDLE_FILES, MAX_CHUNK_BYTES, MAX_FILE_BYTES
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.stl import read_corners
from zensim.sim_server.errors import AssetRefused

if TYPE_CHECKING:
    from collections.abc import Iterable
    from hashlib import _Hash

    from numpy.typing import NDArray

STORE_BUDGET_BYTES = 1 << 30
"""Of all files; those not used for longest go first."""
MAX_UNFINISHED = 512
MAX_CACHED_CORNERS = 256
"""Meshes whose corners are kept in memory: 0.7 MB at most each, 7 kB when it is a hull."""
SHA256_PATTERN = re.compile(r"[0-9a-f]{64}")


@dataclass
class _PartialFile:
    total: int
    received: int = 0
    digest: _Hash = field(default_factory=hashlib.sha256)


class AssetStore:
    """What was sent, and the meshes that were made of it."""

    def __init__(self, budget_bytes: int = STORE_BUDGET_BYTES) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix="zensim-assets-"))
        self._budget_bytes = budget_bytes
        self._sizes: OrderedDict[str, int] = OrderedDict()
        self._pinned: dict[str, int] = {}
        self._loose_bytes = 0
        self._unfinished: OrderedDict[str, _PartialFile] = OrderedDict()
        self._corners: OrderedDict[str, NDArray[np.float32]] = OrderedDict()

    def __contains__(self, sha256: str) -> bool:
        """Whether the whole file is here."""
        return sha256 in self._sizes or sha256 in self._pinned

    def missing(self, sha256s: Iterable[str]) -> list[tuple[str, int]]:
        """List the files that are not here, each with how many of its bytes are.

        Raises:
            AssetRefused: There are too many, or one is no sha256.
        """
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
        """Take the next piece of a file; a piece that is here already changes nothing.

        Returns:
            How many bytes from the start are here.

        Raises:
            AssetRefused: The piece does not fit, or the whole file has another sha256.
        """
        _check_sha256(sha256)
        if sha256 in self:
            return self.size(sha256)
        self._check_piece(sha256, offset, total, len(data))
        file = self._unfinished.setdefault(sha256, _PartialFile(total))
        if offset + len(data) <= file.received and data:
            return file.received
        self._append(sha256, file, data[file.received - offset :])
        if file.received == total:
            self._finish(sha256, file)
        return file.received

    def keep(self, sha256: str, data: bytes) -> None:
        """Keep a file that the server itself made."""
        if sha256 not in self:
            self._path(sha256).write_bytes(data)
            self._add(sha256, len(data))

    def pin(self, sha256: str, data: bytes) -> None:
        """Keep a file for as long as the server runs; it is no part of the budget."""
        if sha256 in self._sizes:
            self._loose_bytes -= self._sizes.pop(sha256)
        self._path(sha256).write_bytes(data)
        self._pinned[sha256] = len(data)

    def pin_kept(self, sha256: str) -> None:
        """Keep a file that is here for as long as the server runs.

        Raises:
            AssetRefused: It is not here.
        """
        size = self.size(sha256)
        if self._sizes.pop(sha256, None) is not None:
            self._loose_bytes -= size
            self._pinned[sha256] = size

    def size(self, sha256: str) -> int:
        """Length of a file.

        Raises:
            AssetRefused: It is not here.
        """
        if sha256 in self._pinned:
            return self._pinned[sha256]
        if (size := self._sizes.get(sha256)) is None:
            raise AssetRefused(
                f"no file {sha256[:80]!r} is here; send it by put_asset",
                slug="bundle.unknown",
                code=ResultCode.NOT_FOUND,
            )
        self._sizes.move_to_end(sha256)
        return size

    def read(self, sha256: str, offset: int, max_bytes: int) -> bytes:
        """Read a piece of a file.

        Raises:
            AssetRefused: It is not here, or is shorter.
        """
        if offset > (size := self.size(sha256)):
            raise AssetRefused(
                f"offset {offset} is beyond the file's {size} bytes", slug="bundle.offset"
            )
        with self._path(sha256).open("rb") as file:
            file.seek(offset)
            return file.read(max_bytes)

    def corners(self, sha256: str) -> NDArray[np.float32]:
        """Find the corners (n, 3) of a mesh that the server made, none twice; they are kept.

        Raises:
            AssetRefused: It is not here.
        """
        if (found := self._corners.get(sha256)) is None:
            found = self._corners[sha256] = _find_unique_corners(
                read_corners(self.read(sha256, 0, -1))
            )
        self._corners.move_to_end(sha256)
        while len(self._corners) > MAX_CACHED_CORNERS:
            self._corners.popitem(last=False)
        return found

    @property
    def folder(self) -> str:
        """Where `<sha256>.stl` is for each mesh that the server made."""
        return str(self._folder)

    def close(self) -> None:
        """Remove the folder."""
        shutil.rmtree(self._folder, ignore_errors=True)

    def _path(self, sha256: str) -> Path:
        # Engines know a mesh by its ending.
        return self._folder / f"{sha256}.stl"

    def _check_piece(self, sha256: str, offset: int, total: int, length: int) -> None:
        if not 0 < total <= MAX_FILE_BYTES:
            raise AssetRefused(
                f"a file of {total} bytes; use 1 to {MAX_FILE_BYTES} bytes", slug="bundle.size"
            )
        if length > MAX_CHUNK_BYTES:
            raise AssetRefused(
                f"a piece of {length} bytes; send {MAX_CHUNK_BYTES} at most", slug="bundle.chunk"
            )
        known = self._unfinished.get(sha256) or _PartialFile(total)
        if total != known.total or offset + length > total:
            raise AssetRefused(
                f"bytes {offset} to {offset + length} of {total}, but the file has {known.total}",
                slug="bundle.total",
            )
        if offset > known.received:
            raise AssetRefused(
                f"offset {offset} leaves a gap; go on from {known.received}", slug="bundle.offset"
            )

    def _append(self, sha256: str, file: _PartialFile, data: bytes) -> None:
        with (self._folder / f"{sha256}.part").open("ab") as out:
            out.write(data)
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
        (self._folder / f"{sha256}.part").rename(self._path(sha256))
        self._add(sha256, file.total)

    def _drop_unfinished(self, sha256: str) -> None:
        del self._unfinished[sha256]
        (self._folder / f"{sha256}.part").unlink(missing_ok=True)

    def _add(self, sha256: str, size: int) -> None:
        self._sizes[sha256] = size
        self._loose_bytes += size
        while self._loose_bytes > self._budget_bytes and len(self._sizes) > 1:
            oldest, freed = self._sizes.popitem(last=False)
            self._loose_bytes -= freed
            self._path(oldest).unlink(missing_ok=True)


def _find_unique_corners(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    """Leave out what is repeated: triangles share corners, six a corner as a rule."""
    whole = np.ascontiguousarray(corners).view(np.dtype((np.void, 3 * corners.itemsize)))
    return np.unique(whole).view(np.float32).reshape(-1, 3)


def _check_sha256(sha256: str) -> str:
    if SHA256_PATTERN.fullmatch(sha256) is None:
        raise AssetRefused(
            f"{sha256[:80]!r} is no sha256; use 64 lower-case hexadecimal digits",
            slug="bundle.name",
        )
    return sha256
