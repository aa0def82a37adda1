"""What a journal holds, row by row. Fields are only ever added, each with a default.

Arrays are little-endian `<f8`, as on the wire.
"""

import hashlib

import msgspec

from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Dynamics, Model
from zensim.proto.messages.spawn_messages import Compat
from zensim.proto.messages.world_messages import WorldResource
from zensim.sim_server.description.sdf.sdf_world import WorldModel

ENCODER = msgspec.msgpack.Encoder()


class ReadAs(msgspec.Struct, frozen=True):
    """How a description was read, so that another server need not read it again."""

    compat: Compat
    allow_missing: bool
    assets: tuple[AssetRef, ...]
    dynamics: Dynamics = ""


class EntityRow(msgspec.Struct, frozen=True, kw_only=True):
    """An entity, and what it needs to be made again."""

    ordinal: int
    """Entities are made again in this order."""
    name: str
    namespace: str
    model: str
    """The sha256 of its model's row."""
    text: str
    """The sha256 of its description's row."""
    initial: bytes
    """State (13,) that a reset goes back to."""
    belongs_to_world: bool = False
    bond: str = ""
    info: EntityInfo | None = None
    read_as: ReadAs | None = None


class WorldRow(msgspec.Struct, frozen=True, kw_only=True):
    """The world that a server has, and the length of its steps."""

    name: str
    """On the network."""
    source: WorldModel
    step_hz: float
    seed: int = 0
    resource: WorldResource = WorldResource()


class ClockRow(msgspec.Struct, frozen=True, kw_only=True):
    """Which time it is, and whether it runs."""

    epoch: int
    steps: int
    state: int
    real_time_factor: float = 1.0


class MotionRow(msgspec.Struct, frozen=True, kw_only=True):
    """Where all entities were at one step."""

    epoch: int
    steps: int
    names: tuple[str, ...]
    base: bytes
    """(n, 13), in the order of `names`."""
    joint_counts: tuple[int, ...]
    joint_positions: bytes


class AnswerRow(msgspec.Struct, frozen=True, kw_only=True):
    """An answer that a retry gets."""

    number: int
    """Answers are given in this order."""
    service: str
    request_id: bytes
    payload: bytes
    encoding: str
    at_s: float
    """Wall time, of the epoch of Unix."""


class AsideRow(msgspec.Struct, frozen=True, kw_only=True):
    """An entity that is not made again, and why."""

    entity: EntityRow
    reason: str


def body_of(model: Model) -> bytes:
    """Write a model as its row holds it."""
    return ENCODER.encode(model)


def sha256_of(body: bytes) -> str:
    """Name a body by its content."""
    return hashlib.sha256(body).hexdigest()


def answer_key(service: str, request_id: bytes) -> str:
    """Name the row of an answer."""
    return f"{service}/{request_id.hex()}"
