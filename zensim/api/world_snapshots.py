"""Snapshots: the state of a world in process as bytes, and back.

What never changes, such as models, is written once for each digest, and restored states share it
with those of this process. The numbers of all arrays are one block of bytes.
"""

import copyreg
import pickle
import sys
import zlib
from collections.abc import Mapping, Sequence
from functools import cache
from hashlib import blake2b
from importlib.metadata import version
from io import BytesIO
from itertools import count
from types import ModuleType
from typing import Any, Literal, NamedTuple

import numpy as np

from zensim.api.api_errors import Invalid
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import JointState, Odometry, TFMessage
from zensim.proto.topic_catalog import TopicSpec
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.topic_remapping import RobotTopicKeys
from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.blueprint import Blueprint
from zensim.sim_server.physics.link_forces import LinkForce
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, SlotAddress

PROTOCOL = 5
MAGIC = b"zensim-snapshot"
WRONG, HINT = "wrong_snapshot", "use the bytes of snapshot() of the same version and engine"
FOLDER = "folder"
"""Stands for the folder of meshes, which is another in each process."""
SHARED = frozenset(
    {
        *(Model, Claim, EntityInfo, Odometry, JointState, TFMessage, TopicSpec, RobotTopicKeys),
        *(GroupKey, Actuation, LinkForce, Blueprint, Archetype, SlotAddress),
    }
)
"""Classes whose objects never change."""
MAX_SHARED = 4096
"""Objects that are kept to be shared."""
ALIGNMENT = 16
"""Of the numbers of an array in their block [bytes]."""
AnyArray = np.ndarray[Any, Any]
ArrayKind = tuple[np.dtype[Any], tuple[int, ...], Literal["C", "F"], bool]
"""Type, shape, order, and whether it may be written."""
SavedArrays = tuple[list[ArrayKind], list[int], list[int], bytearray]
"""Kinds; kind and start of each array; the block."""


class SharedPart(NamedTuple):
    """An object that never changes, and its bytes."""

    value: object
    digest: bytes
    body: bytes
    inner: Mapping[bytes, bytes]
    """Bytes of the shared objects in it, by digest."""


class SharedParts:
    """The shared objects of this process, by identity and by digest."""

    def __init__(self) -> None:
        self._by_id: dict[int, SharedPart] = {}
        self._by_digest: dict[bytes, SharedPart] = {}

    def find(self, value: object) -> SharedPart | None:
        """Find the part of an object."""
        return self._by_id.get(id(value))

    def read(self, digest: bytes) -> SharedPart | None:
        """Find the part of a digest."""
        return self._by_digest.get(digest)

    def keep(self, part: SharedPart) -> SharedPart:
        """Keep an object, so that it is shared and its identity stays its own."""
        if len(self._by_id) >= MAX_SHARED:
            self._by_id.clear()
            self._by_digest.clear()
        self._by_id[id(part.value)] = part
        return self._by_digest.setdefault(part.digest, part)


_SHARED_PARTS = SharedParts()
_FOUND: dict[tuple[str, str], object] = {}
"""Classes and functions by module and name."""


class ArrayBlock:
    """Arrays whose numbers are in one block of bytes."""

    def __init__(self) -> None:
        self._places: dict[int, int] = {}
        self._arrays: list[AnyArray] = []
        self._kinds: dict[ArrayKind, int] = {}
        self._which: list[int] = []
        self._starts: list[int] = []
        self._block = bytearray()

    def add(self, array: AnyArray) -> int:
        """Add an array, once; return its place."""
        if (place := self._places.get(id(array))) is not None:
            return place
        place = self._places[id(array)] = len(self._arrays)
        # Kept, so that its identity stays its own.
        self._arrays.append(array)
        order: Literal["C", "F"] = "F" if array.flags.fnc else "C"
        kind = array.dtype, array.shape, order, array.flags.writeable
        self._which.append(self._kinds.setdefault(kind, len(self._kinds)))
        self._starts.append(len(self._block))
        self._block += array.tobytes(order)
        self._block += bytes(-len(self._block) % ALIGNMENT)
        return place

    def save(self) -> SavedArrays:
        """Take all as objects that can be pickled."""
        return list(self._kinds), self._which, self._starts, self._block


def load_arrays(saved: SavedArrays) -> list[AnyArray]:
    """Make the arrays of a block again."""
    kinds, which, starts, block = saved
    arrays = []
    for number, start in zip(which, starts, strict=True):
        dtype, shape, order, is_writable = kinds[number]
        array: AnyArray = np.ndarray(shape, dtype, block, start, order=order)
        if not is_writable:
            array.flags.writeable = False
        arrays.append(array)
    return arrays


class SnapshotPickler(pickle.Pickler):
    """Writes objects; those that belong to the server are written as their names.

    Attributes:
        parts: Bytes of the shared objects in what was written, by digest.
        arrays: Those in what was written; None where they are written in place.
    """

    def __init__(
        self, stream: BytesIO, fixed: Mapping[str, object], folder: str, root: object = None
    ) -> None:
        super().__init__(stream, PROTOCOL)
        self.parts: dict[bytes, bytes] = {}
        self.arrays = ArrayBlock() if root is None else None
        self._fixed = fixed
        self._names = {id(value): name for name, value in fixed.items()}
        self._folder = folder
        self._root = root
        """A shared object that is written itself."""
        self.dispatch_table = {
            **copyreg.dispatch_table,
            np.ndarray: _reduce_array,
            count: _reduce_count,
            ModuleType: lambda module: (sys.modules.__getitem__, (module.__name__,)),
        }

    def persistent_id(self, value: object) -> str | bytes | int | None:
        """Find the name of an object of the server, digest of a shared one, place of an array."""
        kind = type(value)
        if kind is str:
            return FOLDER if value == self._folder else None
        if isinstance(value, np.ndarray):
            is_own = self.arrays is not None and not _is_view(value) and not value.dtype.hasobject
            return self.arrays.add(value) if self.arrays is not None and is_own else None
        if kind in SHARED and value is not self._root:
            return self._share(value)
        return self._names.get(id(value))

    def _share(self, value: object) -> bytes:
        part = _SHARED_PARTS.find(value) or self._write_part(value)
        self.parts.update(part.inner)
        self.parts[part.digest] = part.body
        return part.digest

    def _write_part(self, value: object) -> SharedPart:
        stream = BytesIO()
        pickler = SnapshotPickler(stream, self._fixed, self._folder, value)
        pickler.dump(value)
        body = stream.getvalue()
        digest = blake2b(body, digest_size=16).digest()
        return _SHARED_PARTS.keep(SharedPart(value, digest, body, pickler.parts))


class SnapshotUnpickler(pickle.Unpickler):
    """Reads objects; names stand for what belongs to the server, digests for shared objects."""

    def __init__(
        self,
        stream: BytesIO,
        fixed: Mapping[str, object],
        folder: str,
        parts: Mapping[bytes, bytes],
        arrays: Sequence[AnyArray] = (),
    ) -> None:
        super().__init__(stream)
        self._arrays = arrays
        self._fixed = {**fixed, FOLDER: folder}
        self._folder = folder
        self._parts = parts
        self._used: dict[bytes, bytes] = {}
        """Those that were read, by digest."""

    def find_class(self, module: str, name: str) -> object:
        """Find a class or function; each is looked up once."""
        if (found := _FOUND.get((module, name))) is None:
            found = _FOUND[module, name] = super().find_class(module, name)
        return found

    def persistent_load(self, name: str | bytes | int) -> object:
        """Find an array, an object of the server, or a shared one."""
        if isinstance(name, int):
            return self._arrays[name]
        if isinstance(name, str):
            return self._fixed[name]
        part = _SHARED_PARTS.read(name) or self._read_part(name)
        self._used.update(part.inner)
        self._used[name] = part.body
        return part.value

    def _read_part(self, digest: bytes) -> SharedPart:
        body = self._parts[digest]
        reader = SnapshotUnpickler(BytesIO(body), self._fixed, self._folder, self._parts)
        value = reader.load()
        return _SHARED_PARTS.keep(SharedPart(value, digest, body, reader._used))


def write_snapshot(engine: str, state: object, fixed: Mapping[str, object], folder: str) -> bytes:
    """Write the state of a world.

    Args:
        engine: Name of its engine.
        state: Objects of any kind.
        fixed: Objects that stay, by name.
        folder: Of meshes.
    """
    stream = BytesIO()
    pickler = SnapshotPickler(stream, fixed, folder)
    pickler.dump(state)
    arrays = pickler.arrays.save() if pickler.arrays is not None else None
    body = pickle.dumps((pickler.parts, arrays), PROTOCOL) + stream.getvalue()
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
    stream = BytesIO(body)
    parts, arrays = pickle.load(stream)
    return SnapshotUnpickler(stream, fixed, folder, parts, load_arrays(arrays)).load()


def _write_header(engine: str) -> bytes:
    python = ".".join(str(number) for number in sys.version_info[:2])
    return b" ".join([MAGIC, _read_version().encode(), python.encode(), engine.encode()])


def _is_view(array: AnyArray) -> bool:
    """Whether an array is a view of another, so that a change of one is a change of both."""
    base = array.base
    return isinstance(base, np.ndarray) and bool(base.flags.writeable) and array.size > 0


def _reduce_array(array: AnyArray) -> tuple[Any, ...]:
    if not _is_view(array):
        return array.__reduce_ex__(PROTOCOL)  # type: ignore[return-value]
    base = array.base
    assert isinstance(base, np.ndarray)
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
