"""Snapshots: the state of a world in process as bytes, and back.

What never changes, such as models, is written once for each digest, and restored states share it
with those of this process.
"""

import sys
from collections.abc import Mapping
from functools import cache
from hashlib import blake2b
from hmac import compare_digest
from importlib.metadata import version
from typing import NamedTuple

import msgspec

from zensim.api.api_errors import Invalid
from zensim.api.object_graphs import GraphReader, GraphWriter, Node, list_attributes
from zensim.api.state_classes import NotState
from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import JointState, Odometry, TFMessage
from zensim.proto.topic_catalog import TopicSpec
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.topic_remapping import RobotTopicKeys
from zensim.sim_server.physics.actuation import Actuation
from zensim.sim_server.physics.blueprint import Blueprint
from zensim.sim_server.physics.engine import EngineRefused
from zensim.sim_server.physics.link_forces import LinkForce
from zensim.sim_server.physics.mujoco.slot_layout import Archetype, SlotAddress

MAGIC, FORMER_MAGIC = b"zensim-state", b"zensim-snapshot"
"""The former one began pickles, which are not read: reading them could run code."""
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
CONSTANTS = {"float_math": FLOAT_MATH, "array_math": ARRAY_MATH}
"""Objects of every process."""
DIGEST_BYTES = 16


class SnapshotPlace(NamedTuple):
    """Where a state is taken, or put.

    Attributes:
        engine: Name of its engine.
        fixed: Objects that stay, by name.
        folder: Of meshes.
        key: Where it is not empty, only bytes that were written with this key are read.
    """

    engine: str
    fixed: Mapping[str, object]
    folder: str
    key: bytes = b""


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


class NamedObjects:
    """What a state names: what belongs to the place, is shared, or is in every process.

    Attributes:
        parts: Bytes of the shared objects that were named, by digest.
    """

    def __init__(
        self, place: SnapshotPlace, known: Mapping[bytes, bytes] | None = None, root: object = None
    ) -> None:
        """Name objects.

        Args:
            place: Where the state is taken, or put.
            known: Bytes of shared objects, to read.
            root: A shared object that is written itself.
        """
        self.parts: dict[bytes, bytes] = {}
        self._place, self._known, self._root = place, known or {}, root
        self._fixed = {**CONSTANTS, **place.fixed}
        self._names = {id(value): name for name, value in self._fixed.items()}

    def name(self, value: object) -> Node | None:
        """See `Outside`."""
        kind = type(value)
        if kind is str:
            return [FOLDER] if value == self._place.folder else None
        if kind in SHARED and value is not self._root:
            part = _SHARED_PARTS.find(value) or self._write_part(value)
            return ["shared", self._note(part)]
        name = self._names.get(id(value))
        return None if name is None else ["fixed", name]

    def find(self, node: Node) -> object:
        """See `Outside`."""
        if node[0] == FOLDER:
            return self._place.folder
        if node[0] == "fixed":
            return self._fixed[node[1]]
        if node[0] != "shared":
            raise NotState(f"kind {str(node[0])[:100]!r}")
        part = _SHARED_PARTS.read(node[1]) or self._read_part(node[1])
        self._note(part)
        return part.value

    def _note(self, part: SharedPart) -> bytes:
        self.parts.update(part.inner)
        self.parts[part.digest] = part.body
        return part.digest

    def _write_part(self, value: object) -> SharedPart:
        inner = NamedObjects(self._place, root=value)
        body = GraphWriter(inner).write(value)
        return _SHARED_PARTS.keep(SharedPart(value, _digest(body), body, inner.parts))

    def _read_part(self, digest: bytes) -> SharedPart:
        body = self._known[digest]
        if _digest(body) != digest:  # or other states would get it for theirs
            raise NotState("a shared part with the digest of another")
        inner = NamedObjects(self._place, self._known)
        value = GraphReader(inner).read(body)
        if type(value) not in SHARED:
            raise NotState(f"a shared part of class {type(value).__name__}")
        return _SHARED_PARTS.keep(SharedPart(value, digest, body, inner.parts))


def write_snapshot(place: SnapshotPlace, state: object) -> bytes:
    """Write the state of a world: an object with all that it refers to.

    Raises:
        NotState: It refers to an object that no state has.
    """
    named = NamedObjects(place)
    graph = GraphWriter(named).write(state)
    body = msgspec.msgpack.encode([named.parts, graph])
    return b"\n".join([_write_header(place), _write_checksum(body, place), body])


def read_snapshot(place: SnapshotPlace, snapshot: bytes) -> object:
    """Read what `write_snapshot` wrote.

    Raises:
        Invalid: It is not a snapshot, damaged, or of another version or engine.
        EngineRefused: The engine cannot restore it here.
    """
    body = _check(place, bytes(snapshot))
    try:
        parts, graph = msgspec.msgpack.decode(body, type=tuple[dict[bytes, bytes], bytes])
        return GraphReader(NamedObjects(place, parts)).read(graph)
    except EngineRefused:
        raise
    except Exception as error:  # whatever wrong bytes lead to: only memory was changed
        raise make_wrong_snapshot(error) from error


def check_like(read: object, present: object) -> None:
    """Check that what was read has the attributes and classes of the present state.

    What containers and structs have may differ; the fields of structs were checked.

    Raises:
        Invalid: It has not.
    """
    left, seen = [("state", read, present)], set[int]()
    while left:
        name, one, other = left.pop()
        if id(other) in seen or one is None or isinstance(other, msgspec.Struct | None):
            continue
        if type(one) is not type(other):
            raise make_wrong_snapshot(NotState(f"'{name}' of class {type(one).__name__}"))
        attributes, found = list_attributes(other), list_attributes(one)
        if attributes:
            seen.add(id(other))
        if wrong := attributes.keys() ^ found.keys():
            raise make_wrong_snapshot(NotState(f"'{name}' with or without {', '.join(wrong)}"))
        left += [(key, found[key], value) for key, value in attributes.items()]


def make_wrong_snapshot(cause: Exception) -> Invalid:
    """Make the error of bytes that are no state of a world."""
    text = f"{type(cause).__name__}: {str(cause)[:200]}"
    return Invalid(f"these bytes are not the state of a world ({text})", slug=WRONG, hint=HINT)


def _check(place: SnapshotPlace, snapshot: bytes) -> bytes:
    """Check header and checksum; return what follows them."""
    header, checksum, body = [*snapshot.split(b"\n", 2), b"", b""][:3]
    wanted = _write_header(place)
    if header.startswith(FORMER_MAGIC):
        raise Invalid(
            "this snapshot is a pickle of an earlier version, and pickles are not read",
            slug=WRONG,
            hint="take it again with snapshot()",
        )
    if not header.startswith(MAGIC):
        raise Invalid("these bytes are not a snapshot", slug=WRONG, hint=HINT)
    if header != wanted:
        given = header[:200].decode(errors="backslashreplace")
        raise Invalid(f"this is {given!r}, not {wanted.decode()!r}", slug=WRONG, hint=HINT)
    if not compare_digest(checksum, _write_checksum(body, place)):
        raise Invalid("the snapshot is damaged", slug=WRONG, hint=HINT)
    return body


def _write_header(place: SnapshotPlace) -> bytes:
    python = ".".join(str(number) for number in sys.version_info[:2])
    return b" ".join([MAGIC, _read_version().encode(), python.encode(), place.engine.encode()])


def _write_checksum(body: bytes, place: SnapshotPlace) -> bytes:
    return blake2b(body, digest_size=DIGEST_BYTES, key=place.key).hexdigest().encode()


def _digest(body: bytes) -> bytes:
    return blake2b(body, digest_size=DIGEST_BYTES).digest()


@cache
def _read_version() -> str:
    return version("zensim")
