"""Row schema of the journal, and the records that the loop submits to the writer thread."""

import hashlib
from dataclasses import dataclass

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Dynamics, Model
from zensim.proto.messages.spawn_messages import Compat
from zensim.proto.messages.world_messages import WorldResource
from zensim.sim_server.description.sdf.sdf_world import WorldModel
from zensim.sim_server.parser_process.description_cache import ParseKey as TextReading
from zensim.sim_server.physics.engine import BodyStates
from zensim.sim_server.world.entity import Entity

ENCODER = msgspec.msgpack.Encoder()


class ParseOptions(msgspec.Struct, frozen=True):
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
    read_as: ParseOptions | None = None


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


class ResponseRow(msgspec.Struct, frozen=True, kw_only=True):
    """An answer that a retry gets."""

    number: int
    """Answers are given in this order."""
    service: str
    request_id: bytes
    payload: bytes
    encoding: str
    at_s: float
    """Wall time, of the epoch of Unix."""


class ExcludedEntityRow(msgspec.Struct, frozen=True, kw_only=True):
    """An entity that is not made again, and why."""

    entity: EntityRow
    reason: str


def encode_model(model: Model) -> bytes:
    """Write a model as its row holds it."""
    return ENCODER.encode(model)


def hash_body(body: bytes) -> str:
    """Name a body by its content."""
    return hashlib.sha256(body).hexdigest()


def make_response_key(service: str, request_id: bytes) -> str:
    """Name the row of an answer."""
    return f"{service}/{request_id.hex()}"


@dataclass(frozen=True)
class JournaledEntity:
    """An entity as the journal knows it."""

    ordinal: int
    entity: Entity
    bond: str = ""
    reading: TextReading | None = None
    """What its model was read from."""

    def has_same_row(self, other: "JournaledEntity") -> bool:
        """Whether a row of this would be that of the other: bodies of an engine are not kept."""
        one, two = self.entity, other.entity
        if (self.ordinal, self.bond) != (other.ordinal, other.bond):
            return False
        return one is two or (
            (one.name, one.namespace, one.born_ns) == (two.name, two.namespace, two.born_ns)
            and one.belongs_to_world == two.belongs_to_world
            and (one.info, one.description) == (two.info, two.description)
            and one.model == two.model
            and np.array_equal(one.initial, two.initial)
        )


@dataclass(frozen=True)
class EntityChange:
    """What became of one name; None where there was or is no entity."""

    name: str
    before: JournaledEntity | None
    after: JournaledEntity | None


@dataclass(frozen=True)
class RecordedMotion:
    """Where all entities were at one step; the arrays are the reading's own."""

    epoch: int
    steps: int
    names: tuple[str, ...]
    joint_counts: npt.NDArray[np.intp]
    reading: BodyStates

    def row(self) -> MotionRow:
        """Write it as its row."""
        return MotionRow(
            epoch=self.epoch,
            steps=self.steps,
            names=self.names,
            base=self.reading.base.tobytes(),
            joint_counts=tuple(self.joint_counts.tolist()),
            joint_positions=self.reading.joint_positions.tobytes(),
        )


@dataclass(frozen=True)
class JournalRecord:
    """What happened since the record before; all of it is kept, or nothing."""

    generation: int
    """Goes up when records could not be written: those of older ones are void."""
    position: int
    changes: tuple[EntityChange, ...] = ()
    world: WorldRow | None = None
    clock: ClockRow | None = None
    motion: RecordedMotion | None = None
    answer: ResponseRow | None = None
    forgotten: tuple[tuple[str, bytes], ...] = ()
    """Answers that no retry gets any more: service and request id."""

    is_asked: bool = False
    """Whether a request changed it: it is undone when it cannot be kept."""
    former: RecordedMotion | None = None
    """Where all were before, for those that are put back."""
