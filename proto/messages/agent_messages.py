"""Messages between agents and the server: claims, drive states, drive commands."""

from collections.abc import Iterator, Sequence
from typing import ClassVar, Literal

import msgspec

from zensim.proto.codec.cdr_reader import MalformedPayload
from zensim.proto.messages.drive_messages import Actuator
from zensim.proto.messages.fault_messages import TopicFault
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt32, UInt64
from zensim.proto.messages.sensing_messages import Environment

STATE_COLUMNS = 13
"""Position x y z, quaternion x y z w, linear x y z, angular x y z: all in the world frame."""

OnRelease = Literal["stop", "keep", "delete"]
StateFormat = Literal["msgpack", "json"]


class ClaimEntityRequest(msgspec.Struct, frozen=True):
    """Claim entities for exclusive control, all or none."""

    ros_type: ClassVar[str] = "zensim/srv/ClaimEntity_Request"

    agent: str = ""
    """Unique; its liveliness token must be up."""
    entities: tuple[str, ...] = ()
    on_release: OnRelease = "stop"
    state_format: StateFormat = "msgpack"
    """Format of the drive states that this agent gets from now on; in JSON, bytes are base64."""
    protocol: UInt32 = 1
    """`PROTOCOL` of the agent; agents that do not say it know the first one."""


class Claim(msgspec.Struct, frozen=True):
    """An entity that an agent controls; encoded as a `Grant`."""

    claim: UInt32
    """Unique per server: commands of old claims are dropped."""
    entity: str
    namespace: str
    model: Model
    robot_description: str = ""
    spawn_state: tuple[float, ...] = ()
    """State at spawn; `STATE_COLUMNS` numbers."""
    environment: Environment = Environment()
    """Environment of the response."""
    joint_targets: tuple[float, ...] = ()
    """Newest targets of the actuators of mode `joint`; empty = never commanded."""


class Grant(msgspec.Struct, frozen=True):
    """A claim that refers to the shared models and descriptions of the response."""

    claim: UInt32
    entity: str
    namespace: str
    model: UInt32
    """Index into `models` of the response."""
    robot_description: UInt32
    """Index into `robot_descriptions` of the response."""
    spawn_state: tuple[float, ...] = ()
    joint_targets: tuple[float, ...] = ()
    """Same as in `Claim`."""


class ClaimEntityResponse(msgspec.Struct, frozen=True):
    """Granted claims, their models and descriptions, and the timing of drive states."""

    ros_type: ClassVar[str] = "zensim/srv/ClaimEntity_Response"

    result: Result = Result()
    grants: tuple[Grant, ...] = ()
    models: tuple[Model, ...] = ()
    robot_descriptions: tuple[str, ...] = ()
    step_ns: UInt64 = 0
    control_steps: UInt32 = 0
    """Steps between two drive states."""
    environment: Environment = Environment()
    actuators: tuple[tuple[Actuator, ...], ...] = ()
    """Targets of a drive command for each of `models`, in order."""


class ClaimShareRequest(msgspec.Struct, frozen=True):
    """Claim a fair share of all robots that no agent has claimed by name.

    The shares of all running pools differ by at most one robot, except for `limit`; robots beyond a
    pool's share are transferred to the caller.
    """

    ros_type: ClassVar[str] = "zensim/srv/ClaimShare_Request"

    agent: str = ""
    """Unique; its liveliness token must be up."""
    limit: UInt32 = 0
    """Maximum number of robots; 0 = unlimited."""
    on_release: OnRelease = "stop"
    protocol: UInt32 = 1
    """`PROTOCOL` of the agent; agents that do not say it know the first one."""


class ClaimShareResponse(ClaimEntityResponse, frozen=True):
    """Claims that are granted in addition to those of the pool."""

    ros_type: ClassVar[str] = "zensim/srv/ClaimShare_Response"

    is_more: bool = False
    """Whether the rest of the share needs another request: the reply size is limited."""


class _SharedTables:
    """Distinct models and texts, with their indices."""

    def __init__(self) -> None:
        self.models: list[Model] = []
        self.texts: dict[str, int] = {}
        self._index_by_id: dict[int, int] = {}
        self._index_by_bytes: dict[bytes, int] = {}

    def model(self, model: Model) -> int:
        """Return the index of a model; equal models have one."""
        if (place := self._index_by_id.get(id(model))) is None:
            encoded = msgspec.msgpack.encode(model)
            place = self._index_by_id[id(model)] = self._index_by_bytes.setdefault(
                encoded, len(self.models)
            )
            if place == len(self.models):
                self.models.append(model)
        return place

    def text(self, text: str) -> int:
        """Return the index of a text."""
        return self.texts.setdefault(text, len(self.texts))


def make_grants(
    claims: Sequence[Claim],
) -> tuple[tuple[Grant, ...], tuple[Model, ...], tuple[str, ...]]:
    """Convert claims to the fields of a response: grants, models and descriptions."""
    shared = _SharedTables()
    grants = tuple(
        Grant(
            one.claim,
            one.entity,
            one.namespace,
            shared.model(one.model),
            shared.text(one.robot_description),
            one.spawn_state,
            one.joint_targets,
        )
        for one in claims
    )
    return grants, tuple(shared.models), tuple(shared.texts)


def expand_grants(response: ClaimEntityResponse) -> tuple[Claim, ...]:
    """Convert the fields of a response to claims.

    Raises:
        MalformedPayload: A grant has an index without a model or description.
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
                response.environment,
                one.joint_targets,
            )
            for one in response.grants
        )
    except IndexError as error:
        raise MalformedPayload("a grant has an index without a model or description") from error


class DriveState(msgspec.Struct, frozen=True):
    """State of all robots of an agent, at one step."""

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
    """Newest claim of the server when this was published: newer claims are missing in `claims`."""
    is_awaited: bool = False
    """Whether the server waits for the command; publish what is due before it."""
    twists: bytes = b""
    """`<f8`, (n, 3), in the order of `claims`: forward, left [m/s], turn [rad/s]. A row counts as a
    `cmd_vel` that arrived before this state; NaN = none. Empty = none at all."""
    order: UInt32 = 0
    """Number of the last order in `twists`; the command repeats it. A state of the same step with
    another number replaces the one before: find the targets again, and publish nothing twice."""
    joint_efforts: bytes = b""
    """`<f8` [N m or N], as `joint_velocities`; NaN of kinematic robots. Empty unless wanted."""
    topic_faults: tuple[TopicFault, ...] = ()
    """Faults of topics that act at this step; those of other agents' robots are among them."""


class FleetOdometry(msgspec.Struct, frozen=True):
    """Odometry of robots of one agent that became due at one step.

    The rows of a step come in as many messages as fit 64 KiB each. A robot has the numbers and the
    rate of its own odometry topic, whose frames and covariances never change.
    """

    ros_type: ClassVar[str] = "zensim/msg/FleetOdometry"

    epoch: UInt32
    step: UInt64
    time_ns: UInt64
    """Stamp of all rows."""
    entities: tuple[str, ...]
    motions: bytes
    """`<f8`, (n, STATE_COLUMNS), in the order of `entities`: position and orientation of the base
    in its odometry frame, linear and angular velocity in the base's own frame."""
    joint_positions: bytes = b""
    """`<f8` [rad or m], (joints of all rows), row by row in the order of `Model.joints`."""
    has_own_tf_rate: bool = False
    """Whether transforms of these robots have another rate than their odometry."""


class TwistCommands(msgspec.Struct, frozen=True):
    """Twists that robots are to keep until the next order, or until their client disappears."""

    ros_type: ClassVar[str] = "zensim/msg/TwistCommands"

    client: str = ""
    """Name of a client; robots stop when its token `sim/<world>/alive/clients/<client>`
    disappears."""
    entities: tuple[str, ...] = ()
    twists: bytes = b""
    """`<f8`, (n, 3), in the order of `entities`: forward, left [m/s], turn [rad/s]. NaN releases a
    robot: only its own `cmd_vel` counts again."""


MAX_ORDERED_ROBOTS = 2500
"""Robots in one message: with the longest names less than `MAX_FLEET_COMMAND_BYTES`."""


def split_orders(twists: TwistCommands) -> Iterator[TwistCommands]:
    """Split orders into messages that a router lets pass: it drops larger ones."""
    row_bytes = 3 * 8
    for start in range(0, max(1, len(twists.entities)), MAX_ORDERED_ROBOTS):
        end = start + MAX_ORDERED_ROBOTS
        yield TwistCommands(
            twists.client,
            twists.entities[start:end],
            twists.twists[start * row_bytes : end * row_bytes],
        )


class DriveCommand(msgspec.Struct, frozen=True):
    """Targets of all robots of an agent; the newest is applied.

    Only a command with the epoch, step and claims of an awaited state completes it.
    """

    ros_type: ClassVar[str] = "zensim/msg/DriveCommand"

    epoch: UInt32
    step: UInt64
    """Step of the drive state."""
    claims: bytes
    """`<u4`, (n,)."""
    targets: bytes
    """`<f8`, claim by claim, `width` numbers for each of `Model.actuators`."""
    order: UInt32 = 0
    """Order of the drive state."""
    wants_efforts: bool = False
    """Whether the next states shall have `joint_efforts`."""
    withheld_hz: UInt32 = 0
    """Messages a second that subscribers by wildcard did not get, as they exceed the budget."""
    rest_ns: UInt32 = 0
    """Simulation and wall time [ns] for which the agent needs no further state, unless its claims
    or ordered twists change; 0 = it needs the next one."""
