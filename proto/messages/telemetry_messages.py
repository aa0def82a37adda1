"""Telemetry of the server: info, clock, stats, snapshot, events, models."""

from typing import ClassVar, Literal, get_args

import msgspec

from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.process_messages import ProcessUsage
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt32, UInt64
from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.messages.standard_messages import Clock, Pose
from zensim.proto.messages.world_messages import Scene

StateName = Literal["stopped", "playing", "paused", "quitting", "no_world", "loading_world"]
ServerStateName = Literal[
    "stopped", "playing", "paused", "quitting", "no_world", "loading_world", "restoring"
]
"""State of the simulation, or `restoring`: the journal is restored, and other requests wait."""


PROTOCOL = 1
"""Number of the keys and messages; it changes when older clients would misread newer servers."""


class InfoRequest(msgspec.Struct, frozen=True):
    """Get the status of the server."""

    ros_type: ClassVar[str] = "zensim/srv/Info_Request"


class Info(msgspec.Struct, frozen=True):
    """Status of the server."""

    ros_type: ClassVar[str] = "zensim/srv/Info_Response"

    result: Result = Result()
    world: str = ""
    version: str = ""
    sim_time_s: float = 0.0
    steps: UInt64 = 0
    epoch: UInt32 = 0
    step_ns: UInt64 = 0
    real_time_factor: float = 0.0
    """Mean of the last second; 0 while paused."""
    target_real_time_factor: float = 0.0
    """0 = unlimited."""
    entities: UInt32 = 0
    agents: UInt32 = 0
    claimed: UInt32 = 0
    state: ServerStateName = "stopped"
    engine: str = ""
    world_model: str = ""
    seed: UInt64 = 0
    is_lockstep: bool = False
    """Whether every control step waits for the agents; steps of goals always do."""
    protocol: UInt32 = 0
    """`PROTOCOL` of the server; 0 = from before there were numbers."""
    role: str = ""
    """Role of the caller; empty if the server is not secured, or does not admit its user."""
    driven: UInt32 = 0
    """Claimed robots whose agent has sent a command since it claimed them."""
    restored: UInt32 = 0
    """Entities that are restored so far, in the state `restoring`."""
    to_restore: UInt32 = 0
    """Entities of the journal, in that state."""


class WorldClock(Clock, frozen=True):
    """Adds step and epoch; a reset of time increments the epoch."""

    step: UInt64 = 0
    epoch: UInt32 = 0


class AgentCommands(msgspec.Struct, frozen=True):
    """Drive commands of an agent: one is due for each step whose state it got.

    It is due when it comes, or when the next state is sent.
    """

    ros_type: ClassVar[str] = "zensim/msg/AgentCommands"

    taken: UInt64 = 0
    """Steps that it sent a command for, since it came."""
    due: UInt64 = 0
    taken_hz: float = 0.0
    """Rate of taken steps in the last second, by wall time."""
    due_hz: float = 0.0


class Stats(msgspec.Struct, frozen=True):
    """Statistics of the server loop; wall times [s] over the last second."""

    ros_type: ClassVar[str] = "zensim/msg/Stats"

    world: str = ""
    sim_time_s: float = 0.0
    steps: UInt64 = 0
    real_time_factor: float = 0.0
    state: StateName = "stopped"
    entities: UInt32 = 0
    agents: UInt32 = 0
    claimed: UInt32 = 0
    step_time_s: float = 0.0
    """Mean engine time of a step."""
    step_time_max_s: float = 0.0
    late_max_s: float = 0.0
    """Maximum delay of a step after its deadline."""
    slipped_s: float = 0.0
    """Wall time lost to overruns since start."""
    requests: UInt64 = 0
    commands: UInt64 = 0
    dropped: UInt64 = 0
    """Commands dropped since start: malformed, stale or not finite."""
    ready_s: dict[str, float] = {}
    """Wall time from spawn to first command, by entity."""
    target_real_time_factor: float = 0.0
    """0 = unlimited."""
    awaited: tuple[str, ...] = ()
    """Agents, and sensor processes as `sensors/NAME`, whose replies the loop waits for now."""
    misses: dict[str, UInt64] = {}
    """States without a reply in time, by agent or sensor process; only agents with claims."""
    kinematic: UInt32 = 0
    """Entities that move as their drives compute, not by forces and contacts."""
    busy_max_s: float = 0.0
    """Maximum CPU time of the loop before a step; the rest of `late_max_s` is due to the host."""
    sensor_processes: tuple[str, ...] = ()
    """Sensor processes that publish now."""
    sensor_messages: UInt64 = 0
    """Published by the present sensor processes since they started."""
    late_sensor_messages: UInt64 = 0
    """See `SensorsReply.late`."""
    refused: UInt64 = 0
    """Requests that a secured server refused since start: see `AuditRecord`."""
    accepted: UInt64 = 0
    """Requests that may change something, which a secured server accepted since start."""
    joined: UInt64 = 0
    """Sessions that joined a secured server since start."""
    usage: ProcessUsage = ProcessUsage()
    """Usage of the process of the server, without its worker processes."""
    driven: UInt32 = 0
    """See `Info.driven`."""
    agent_commands: dict[str, AgentCommands] = {}
    """Commands by agent. The real-time factor alone does not show an agent that misses states."""


class AuditRecord(msgspec.Struct, frozen=True):
    """What a user of a secured server did, or was refused."""

    ros_type: ClassVar[str] = "zensim/msg/AuditRecord"

    action: str = ""
    """`joined`, `left`, `accepted` (a request that may change something) or `refused`."""
    user: str = ""
    """Empty for a session that does not say whose it is, and for a request without a user."""
    role: str = ""
    service: str = ""
    """Empty for a session that joined or left."""
    subject: str = ""
    """Names, texts and numbers of the request, in short."""
    reason: str = ""
    """Reason of a refusal."""
    address: str = ""
    """Address of the session that the request names, as the router has it; empty without one."""
    count: UInt64 = 1
    """Actions that this record stands for: all but a burst of like ones are counted only."""
    time_ns: UInt64 = 0
    """Wall time since the epoch."""


class Snapshot(msgspec.Struct, frozen=True):
    """State of all entities at one step."""

    ros_type: ClassVar[str] = "zensim/msg/Snapshot"

    epoch: UInt32
    step: UInt64
    time_ns: UInt64
    roster: UInt32
    """Changes with each spawn and deletion: call `get_models` again."""
    names: tuple[str, ...]
    base: bytes
    """`<f8`, (n, 13), see `agent_messages.STATE_COLUMNS`, in the order of `names`."""
    joint_positions: bytes
    """`<f8`, all joints of all entities, model by model in the order of `Model.joints`."""
    real_time_factor: float = 0.0
    state: StateName = "stopped"


EventKind = Literal[
    "spawned",
    "deleted",
    "claimed",
    "released",
    "reset",
    "played",
    "paused",
    "stopped",
    "loading",
    "loaded",
    "unloaded",
    "quitting",
    "missed",
    "timed_out",
    "touched",
    "warning",
]


EVENT_KINDS: tuple[str, ...] = get_args(EventKind)


class Event(msgspec.Struct, frozen=True):
    """A change in the world."""

    ros_type: ClassVar[str] = "zensim/msg/Event"

    kind: EventKind
    entity: str = ""
    agent: str = ""
    step: UInt64 = 0
    epoch: UInt32 = 0
    message: str = ""


class GetModelsRequest(msgspec.Struct, frozen=True):
    """Get the models of entities; all if empty."""

    ros_type: ClassVar[str] = "zensim/srv/GetModels_Request"

    entities: tuple[str, ...] = ()
    wants_descriptions: bool = False
    """Whether to return the texts that the entities were spawned from, too."""


class EntityModel(msgspec.Struct, frozen=True):
    """An entity and its model."""

    entity: str
    namespace: str
    model: UInt32
    """Index into `GetModelsResponse.models`."""
    agent: str = ""
    initial_pose: Pose = Pose()
    belongs_to_world: bool = False
    """Whether it is part of the world file."""
    description: UInt32 = 0
    """Index into `GetModelsResponse.descriptions`, if these were wanted."""
    is_falling: bool = False
    """Whether it has left the world: it falls, and nothing is below it."""


class ModelFiles(msgspec.Struct, frozen=True):
    """Files that the description of a model names."""

    files: tuple[AssetRef, ...] = ()
    """Files to read with `get_asset`."""


class GetModelsResponse(msgspec.Struct, frozen=True):
    """Distinct models, and the entities that use them."""

    ros_type: ClassVar[str] = "zensim/srv/GetModels_Response"

    result: Result = Result()
    roster: UInt32 = 0
    entities: tuple[EntityModel, ...] = ()
    models: tuple[Model, ...] = ()
    scene: Scene = Scene()
    """Lights and colours of the world."""
    environment: Environment = Environment()
    descriptions: tuple[str, ...] = ()
    """Distinct texts, URDF or SDF; empty for entities of the world file."""
    files: tuple[ModelFiles, ...] = ()
    """Files by index of `models`, if descriptions were wanted; empty for models read long ago."""
