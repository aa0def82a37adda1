"""Binary STL files, in which the server stores and sends generated meshes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

STL_HEAD = 84
STL_RECORD = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])


def stl_size(triangles: int) -> int:
    """Compute the file size [bytes]."""
    return STL_HEAD + triangles * STL_RECORD.itemsize


def write_corners(corners: NDArray[np.floating]) -> bytes:
    """Write triangles (f, 3, 3)."""
    records = np.zeros(len(corners), STL_RECORD)
    records["corners"] = corners
    return b"zensim".ljust(80, b"\0") + len(records).to_bytes(4, "little") + records.tobytes()


def read_corners(data: bytes, count: int = -1) -> NDArray[np.float32]:
    """Read the corners (3 f, 3) of the first `count` triangles; -1 = all.

    Raises:
        ValueError: The data is too short.
    """
    corners = np.frombuffer(data, STL_RECORD, count, STL_HEAD)["corners"]
    return corners.reshape(-1, 3)
