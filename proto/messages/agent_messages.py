"""Messages between agents and the server: claims, drive states, drive commands."""

from collections.abc import Sequence
from typing import ClassVar, Literal

import msgspec

from zensim.proto.codec.cdr import MalformedPayload
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt32, UInt64

STATE_COLUMNS = 13
"""Position x y z, quaternion x y z w, linear x y z, angular x y z: all in the world frame."""

OnRelease = Literal["stop", "keep", "delete"]


class ClaimEntityRequest(msgspec.Struct, frozen=True):
    """Ask to be the only driver of these entities, all or none of them."""

    ros_type: ClassVar[str] = "zensim/srv/ClaimEntity_Request"

    agent: str = ""
    """Unique; its liveliness token must be up."""
    entities: tuple[str, ...] = ()
    on_release: OnRelease = "stop"


class Claim(msgspec.Struct, frozen=True):
    """What an agent needs to know of one entity that it drives; it travels as a `Grant`."""

    claim: UInt32
    """Never used twice by one server: a command under an old claim is dropped."""
    entity: str
    namespace: str
    model: Model
    robot_description: str = ""
    spawn_state: tuple[float, ...] = ()
    """State at spawn, `STATE_COLUMNS` numbers."""


class Grant(msgspec.Struct, frozen=True):
    """A claim as it travels: what many entities share is said once, beside it."""

    claim: UInt32
    entity: str
    namespace: str
    model: UInt32
    """Index into `models` of the response."""
    robot_description: UInt32
    """Index into `robot_descriptions` of the response."""
    spawn_state: tuple[float, ...] = ()


class ClaimEntityResponse(msgspec.Struct, frozen=True):
    """The claims, each model and text once, and the clock that the drive runs by."""

    ros_type: ClassVar[str] = "zensim/srv/ClaimEntity_Response"

    result: Result = Result()
    grants: tuple[Grant, ...] = ()
    models: tuple[Model, ...] = ()
    robot_descriptions: tuple[str, ...] = ()
    step_ns: UInt64 = 0
    control_steps: UInt32 = 0
    """Steps between two drive states."""


class ClaimShareRequest(msgspec.Struct, frozen=True):
    """Ask, as a pool, for a fair share of all robots that nobody drives by name.

    The shares of all pools that are up differ by one robot at most, but for `limit`; what a pool
    has beyond its share goes to the pool that asks.
    """

    ros_type: ClassVar[str] = "zensim/srv/ClaimShare_Request"

    agent: str = ""
    """Unique; its liveliness token must be up."""
    limit: UInt32 = 0
    """Most robots that it drives; 0 = any number."""
    on_release: OnRelease = "stop"


class ClaimShareResponse(ClaimEntityResponse, frozen=True):
    """What was granted now, beside what the pool has already."""

    ros_type: ClassVar[str] = "zensim/srv/ClaimShare_Response"

    is_more: bool = False
    """Whether the rest of the share waits for another request: replies have a largest size."""


class _SharedTables:
    """Models and texts, each once, and where each stands."""

    def __init__(self) -> None:
        self.models: list[Model] = []
        self.texts: dict[str, int] = {}
        self._index_by_id: dict[int, int] = {}
        self._index_by_bytes: dict[bytes, int] = {}

    def model(self, model: Model) -> int:
        """Find the place of a model; two that say the same are one."""
        if (place := self._index_by_id.get(id(model))) is None:
            said = msgspec.msgpack.encode(model)
            place = self._index_by_id[id(model)] = self._index_by_bytes.setdefault(
                said, len(self.models)
            )
            if place == len(self.models):
                self.models.append(model)
        return place

    def text(self, text: str) -> int:
        """Find the place of a text."""
        return self.texts.setdefault(text, len(self.texts))


def make_grants(
    claims: Sequence[Claim],
) -> tuple[tuple[Grant, ...], tuple[Model, ...], tuple[str, ...]]:
    """Write claims down for a response: grants, models and texts."""
    shared = _SharedTables()
    grants = tuple(
        Grant(
            one.claim,
            one.entity,
            one.namespace,
            shared.model(one.model),
            shared.text(one.robot_description),
            one.spawn_state,
        )
        for one in claims
    )
    return grants, tuple(shared.models), tuple(shared.texts)


def expand_grants(response: ClaimEntityResponse) -> tuple[Claim, ...]:
    """Read the claims of a response; those of one model share it.

    Raises:
        MalformedPayload: A grant speaks of a model or text that is not there.
    """
    models, texts = response.models, response.robot_descriptions
    try:
        return tuple(
            Claim(
                one.claim,
                one.entity,
                one.namespace,
                models[one.model],
                texts[one.robot_description],
                one.spawn_state,
            )
            for one in response.grants
        )
    except IndexError as error:
        raise MalformedPayload("a grant speaks of a model or text that is not there") from error


class DriveState(msgspec.Struct, frozen=True):
    """Everything that one agent drives, at one step."""

    ros_type: ClassVar[str] = "zensim/msg/DriveState"

    epoch: UInt32
    step: UInt64
    time_ns: UInt64
    claims: bytes
    """`<u4`, (n,)."""
    base: bytes
    """`<f8`, (n, STATE_COLUMNS), in the order of `claims`."""
    joint_positions: bytes
    """`<f8`, all joints of all claims, model by model in the order of `Model.joints`."""
    joint_velocities: bytes
    newest_claim: UInt32 = 0
    """The newest of all claims when this was told: an older state says nothing of a newer claim."""
    is_awaited: bool = False
    """Time stands until the answer comes: what the state makes due is published before it."""


class DriveCommand(msgspec.Struct, frozen=True):
    """Targets for everything that one agent drives; the newest wins.

    An awaited state is answered by the command of its own epoch, step and claims, by no other.
    """

    ros_type: ClassVar[str] = "zensim/msg/DriveCommand"

    epoch: UInt32
    step: UInt64
    """Of the drive state that it answers."""
    claims: bytes
    """`<u4`, (n,)."""
    targets: bytes
    """`<f8`, for each of `Model.actuators` as many numbers as its width, claim by claim."""
