"""Compression of the chunks of a recording: Zstandard, as Python 3.14 and its backport have it."""

import sys
from collections.abc import Iterator
from typing import Final

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

LEVEL: Final = 1
"""Level as fast as LZ4, and a third smaller; the default one takes up to 1.7 times the time."""
PIECE_BYTES: Final = 1 << 20
MAX_CHUNK_BYTES: Final = 256 << 20
"""Most bytes of the records of a chunk: a megabyte of Zstandard can hold 30 GB."""
FREE_BYTES: Final = 96 << 20
"""Bytes of records that any chunk may have, and a file without index in all: the largest message
and the chunk that it ends."""
MAX_RATIO: Final = 1000
"""Bytes of records for each byte of a file beyond them; recordings of robots have 3 to 50."""


class DamagedChunk(ValueError):
    """The bytes of a chunk are not what was written."""


def compress(content: bytes | bytearray, level: int = LEVEL) -> bytes:
    """Compress the records of a chunk.

    Args:
        content: Records.
        level: Of Zstandard, 1 (fast) to 22 (small).
    """
    compressed: bytes = zstd.compress(content, level)
    return compressed


def decompress(compressed: bytes, compression: str, size: int) -> bytes:
    """Decompress the records of a chunk that has this size [bytes].

    Raises:
        DamagedChunk: It has another size, more than it may have, or is damaged.
        ValueError: The compression is not supported.
    """
    if not compression:
        return compressed
    if compression == "lz4":
        raise ValueError(
            "chunks are compressed by 'lz4'; convert the file by 'mcap compress --compression zstd'"
        )
    if compression != "zstd":  # MCAP has no other
        raise DamagedChunk(f"compression {compression[:20]!r} is not known")
    if size > (most := min(MAX_CHUNK_BYTES, find_most_bytes(len(compressed)))):
        raise DamagedChunk(f"the chunk claims {size} bytes; at most are {most}")
    try:
        content: bytes = zstd.ZstdDecompressor().decompress(compressed, size + 1)
    except zstd.ZstdError as error:
        raise DamagedChunk(str(error)) from error
    if len(content) != size:
        raise DamagedChunk(f"the chunk has not {size} bytes")
    return content


def find_most_bytes(compressed: int) -> int:
    """Find how many bytes of records so many bytes of a file may have."""
    return FREE_BYTES + MAX_RATIO * compressed


class CompressedLog:
    """Bytes that are appended, kept compressed, and read once from the start.

    The index of a recording of hours has a hundred megabytes.
    """

    def __init__(self) -> None:
        self._compressor = zstd.ZstdCompressor(LEVEL)
        self._pieces: list[bytes] = []
        self.size = 0
        """Bytes that were appended."""

    def append(self, content: bytes) -> None:
        """Append."""
        self.size += len(content)
        self._pieces.append(self._compressor.compress(content))

    def read(self) -> Iterator[bytes]:
        """Read all bytes in pieces; nothing can be appended then."""
        self._pieces.append(self._compressor.flush())
        decompressor = zstd.ZstdDecompressor()
        for piece in self._pieces:
            while piece or not (decompressor.eof or decompressor.needs_input):
                found = decompressor.decompress(piece, PIECE_BYTES)
                piece = b""  # noqa: PLW2901  the decompressor keeps the rest
                if found:
                    yield found
                if decompressor.eof or decompressor.needs_input:
                    break
