"""Snapshots: the state of a world in process as bytes, and back."""

import copyreg
import pickle
import sys
import zlib
from collections.abc import Mapping
from functools import cache
from importlib.metadata import version
from io import BytesIO
from itertools import count
from types import ModuleType
from typing import Any

import numpy as np

from zensim.api.api_errors import Invalid

PROTOCOL = 5
MAGIC = b"zensim-snapshot"
WRONG, HINT = "wrong_snapshot", "use the bytes of snapshot() of the same version and engine"
FOLDER = "folder"
"""Stands for the folder of meshes, which is another in each process."""


class SnapshotPickler(pickle.Pickler):
    """Writes objects; those that belong to the server are written as their names."""

    def __init__(self, stream: BytesIO, fixed: Mapping[str, object], folder: str) -> None:
        super().__init__(stream, PROTOCOL)
        self._names = {id(value): name for name, value in fixed.items()}
        self._folder = folder
        self.dispatch_table = {
            **copyreg.dispatch_table,
            np.ndarray: _reduce_array,
            count: _reduce_count,
            ModuleType: lambda module: (sys.modules.__getitem__, (module.__name__,)),
        }

    def persistent_id(self, value: object) -> str | None:
        """Find the name of an object that is not written."""
        if type(value) is str:
            return FOLDER if value == self._folder else None
        return self._names.get(id(value))


class SnapshotUnpickler(pickle.Unpickler):
    """Reads objects; names stand for what belongs to the server."""

    def __init__(self, stream: BytesIO, fixed: Mapping[str, object], folder: str) -> None:
        super().__init__(stream)
        self._fixed = {**fixed, FOLDER: folder}

    def persistent_load(self, name: str) -> object:
        """Find an object of the server."""
        return self._fixed[name]


def write_snapshot(engine: str, state: object, fixed: Mapping[str, object], folder: str) -> bytes:
    """Write the state of a world.

    Args:
        engine: Name of its engine.
        state: Objects of any kind.
        fixed: Objects that stay, by name.
        folder: Of meshes.
    """
    stream = BytesIO()
    SnapshotPickler(stream, fixed, folder).dump(state)
    body = stream.getvalue()
    return b"\n".join([_write_header(engine), b"%08x" % zlib.crc32(body), body])


def read_snapshot(engine: str, snapshot: bytes, fixed: Mapping[str, object], folder: str) -> object:
    """Read what `write_snapshot` wrote.

    Raises:
        Invalid: It is not a snapshot, damaged, or of another version or engine.
    """
    header, checksum, body = [*bytes(snapshot).split(b"\n", 2), b"", b""][:3]
    wanted = _write_header(engine)
    if not header.startswith(MAGIC):
        raise Invalid("these bytes are not a snapshot", slug=WRONG, hint=HINT)
    if header != wanted:
        raise Invalid(
            f"this is '{header.decode()}', not '{wanted.decode()}'", slug=WRONG, hint=HINT
        )
    if checksum != b"%08x" % zlib.crc32(body):
        raise Invalid("the snapshot is damaged", slug=WRONG, hint=HINT)
    return SnapshotUnpickler(BytesIO(body), fixed, folder).load()


def _write_header(engine: str) -> bytes:
    python = ".".join(str(number) for number in sys.version_info[:2])
    return b" ".join([MAGIC, _read_version().encode(), python.encode(), engine.encode()])


def _reduce_array(array: np.ndarray[Any, Any]) -> tuple[Any, ...]:
    base = array.base
    if not isinstance(base, np.ndarray) or not base.flags.writeable or not array.size:
        return array.__reduce_ex__(PROTOCOL)  # type: ignore[return-value]
    offset = array.__array_interface__["data"][0] - base.__array_interface__["data"][0]
    return _make_view, (base, array.dtype, offset, array.shape, array.strides)


def _make_view(
    base: np.ndarray[Any, Any],
    dtype: np.dtype[Any],
    offset: int,
    shape: tuple[int, ...],
    strides: tuple[int, ...],
) -> np.ndarray[Any, Any]:
    """Make a view of an array, so that a change of one is a change of both."""
    buffer = base if base.flags.c_contiguous else base.T
    view: np.ndarray[Any, Any] = np.ndarray(shape, dtype, buffer, offset, strides)
    return view


def _reduce_count(numbers: "count[int]") -> tuple[Any, ...]:
    return count, (int(repr(numbers).partition("(")[2].rstrip(")")),)


@cache
def _read_version() -> str:
    return version("zensim")
