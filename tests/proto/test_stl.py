"""Binary STL is read as written; other bytes are refused."""

import numpy as np
import pytest

from zensim.proto.stl import read_corners, stl_size, write_corners

CORNERS = np.arange(18.0).reshape(2, 3, 3)


def test_written_triangles_are_read_back() -> None:
    data = write_corners(CORNERS)

    assert len(data) == stl_size(2)
    assert read_corners(data).tolist() == CORNERS.reshape(6, 3).tolist()
    assert read_corners(data, 1).tolist() == CORNERS[0].tolist()


@pytest.mark.parametrize("data", [b"", b"short", write_corners(CORNERS)[:-1]])
def test_bytes_without_triangles_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="buffer"):
        read_corners(data)
