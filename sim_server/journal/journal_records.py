"""Rows of the journal, and the records that the loop submits to the writer thread."""

import hashlib
from dataclasses import dataclass

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.proto.messages.model_messages import Dynamics, Model
from zensim.proto.messages.spawn_messages import Compat
from zensim.proto.messages.world_messages import WorldResource
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.parser_process.description_cache import ParseKey
from zensim.sim_server.physics.engine import BodyStates
from zensim.sim_server.world.entity import Entity

ENCODER = msgspec.msgpack.Encoder()


class ParseOptions(msgspec.Struct, frozen=True):
    """How a description was parsed, so that the next server need not parse it again."""

    compat: Compat
    allow_missing: bool
    assets: tuple[AssetRef, ...]
    dynamics: Dynamics = ""
    controllers: tuple[str, ...] = ()
    drive: DriveOrder = DriveOrder()


class EntityRow(msgspec.Struct, frozen=True, kw_only=True):
    """An entity and the arguments to spawn it again."""

    ordinal: int
    """Entities are restored in this order."""
    name: str
    namespace: str
    model: str
    """Key of its row of kind model: a sha256."""
    text: str
    """Key of its row of kind text: a sha256."""
    initial: bytes
    """State (13,) that a reset restores."""
    belongs_to_world: bool = False
    bond: str = ""
    info: EntityInfo | None = None
    read_as: ParseOptions | None = None


class WorldRow(msgspec.Struct, frozen=True, kw_only=True):
    """The world of a server, and its step rate."""

    name: str
    """World name in keys on the network."""
    source: WorldModel
    step_rate_hz: float = msgspec.field(name="step_hz")
    seed: int = 0
    resource: WorldResource = WorldResource()


class ClockRow(msgspec.Struct, frozen=True, kw_only=True):
    """Simulation time and state."""

    epoch: int
    steps: int
    state: int
    real_time_factor: float = 1.0


class MotionRow(msgspec.Struct, frozen=True, kw_only=True):
    """States of all entities at one step."""

    epoch: int
    steps: int
    names: tuple[str, ...]
    base: bytes
    """(n, 13), in the order of `names`."""
    joint_counts: tuple[int, ...]
    joint_positions: bytes


class ResponseRow(msgspec.Struct, frozen=True, kw_only=True):
    """A response that a repeated request gets."""

    number: int
    """Order of the responses."""
    service: str
    request_id: bytes
    payload: bytes
    encoding: str


class ExcludedEntityRow(msgspec.Struct, frozen=True, kw_only=True):
    """An entity that is not restored, and the reason."""

    entity: EntityRow
    reason: str


def encode_model(model: Model) -> bytes:
    """Encode a model for its row."""
    return ENCODER.encode(model)


def hash_body(body: bytes) -> str:
    """Compute the key of a row from its body."""
    return hashlib.sha256(body).hexdigest()


def make_response_key(service: str, request_id: bytes) -> str:
    """Make the key of the row of a response."""
    return f"{service}/{request_id.hex()}"


@dataclass(frozen=True)
class JournaledEntity:
    """An entity, its order and its bond."""

    ordinal: int
    entity: Entity
    bond: str = ""
    parse_key: ParseKey | None = None
    """What its model was parsed from."""

    def has_same_row(self, other: "JournaledEntity") -> bool:
        """Whether both have the same row; bodies of an engine are not stored."""
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
    """The change of the entity of one name; None where there was or is none."""

    name: str
    before: JournaledEntity | None
    after: JournaledEntity | None

    @property
    def is_spawn(self) -> bool:
        """Whether another entity has the name now."""
        if self.after is None:
            return False
        return self.before is None or self.before.ordinal != self.after.ordinal


@dataclass(frozen=True)
class RecordedMotion:
    """States of all entities at one step; the arrays are shared with the world."""

    epoch: int
    steps: int
    names: tuple[str, ...]
    joint_counts: npt.NDArray[np.intp]
    states: BodyStates

    def row(self) -> MotionRow:
        """Make the row."""
        return MotionRow(
            epoch=self.epoch,
            steps=self.steps,
            names=self.names,
            base=self.states.base.tobytes(),
            joint_counts=tuple(self.joint_counts.tolist()),
            joint_positions=self.states.joint_positions.tobytes(),
        )


@dataclass(frozen=True)
class JournalRecord:
    """The changes since the previous record; written all or nothing."""

    generation: int
    """Increases when records could not be written: those of older generations are dropped."""
    position: int
    changes: tuple[EntityChange, ...] = ()
    world: WorldRow | None = None
    clock: ClockRow | None = None
    motion: RecordedMotion | None = None
    response: ResponseRow | None = None
    expired: tuple[tuple[str, bytes], ...] = ()
    """Responses that expired: service and request id."""

    is_requested: bool = False
    """Whether a request made the changes: they are undone if they cannot be written."""
    former: RecordedMotion | None = None
    """The previous states, for entities that are restored by undo."""
