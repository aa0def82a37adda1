"""Requests and responses of simulation_interfaces 2.1, and the table of services.

A class's `ros_type` names the exact ROS interface; fields that a subclass adds travel in
MessagePack and JSON only.
"""

from enum import IntEnum
from typing import ClassVar

import msgspec

from zensim.proto import drives
from zensim.proto.assets import AssetRef
from zensim.proto.geometry import Accel, Pose, PoseStamped, Twist, Vector3
from zensim.proto.header import Header
from zensim.proto.info import EntityCategory, EntityInfo
from zensim.proto.model import Dynamics, ReportEntry
from zensim.proto.result import Result
from zensim.proto.widths import UInt8, UInt16, UInt64

Compat = drives.Compat

MAX_REQUEST_BYTES = 3 << 20
"""Of any request as it is sent: decoding a longer one would make physics late."""


class Resource(msgspec.Struct, frozen=True):
    """A description by shipped name or as text. Source: simulation_interfaces/msg/Resource."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Resource"

    uri: str = ""
    resource_string: str = ""


class SpawnEntityRequest(msgspec.Struct, frozen=True):
    """Put one entity into the world. Source: simulation_interfaces/srv/SpawnEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntity_Request"

    name: str = ""
    allow_renaming: bool = False
    entity_resource: Resource = Resource()
    entity_namespace: str = ""
    initial_pose: PoseStamped = PoseStamped()


class SpawnEntityOrder(SpawnEntityRequest, frozen=True):
    """A spawn with wishes that simulation_interfaces has no field for."""

    snap_to_ground: bool = False
    """Move the entity along z until its lowest point touches z = 0."""
    strict: bool = False
    """Refuse what the report would call suspicious."""
    allow_missing: bool = False
    """Leave out collisions whose mesh is not on the server."""
    dry_run: bool = False
    """Check everything, say what would be done, and do nothing."""
    compat: Compat = "fixed"
    """Whether drives behave sanely, or with the documented quirks of Gazebo 11."""
    bond: str = ""
    """A name; the entity goes when the liveliness token `sim/<world>/bond/<name>` does."""
    assets: tuple[AssetRef, ...] = ()
    """Which file stands behind which uri of the description; sent before by `put_asset`."""
    info: EntityInfo | None = None
    """None = derived from the description, see `set_entity_info`."""
    dynamics: Dynamics = ""
    """Full, kinematic, or either as need be; empty = as the world is by default."""


class SpawnEntityResponse(msgspec.Struct, frozen=True):
    """The name that it got. Source: simulation_interfaces/srv/SpawnEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntity_Response"

    result: Result = Result()
    entity_name: str = ""


class SpawnEntityReport(SpawnEntityResponse, frozen=True):
    """What a spawn did besides its result: the namespace, and how the description was read."""

    entity_namespace: str = ""
    report: tuple[ReportEntry, ...] = ()


class DeleteEntityRequest(msgspec.Struct, frozen=True):
    """Take one entity out. Source: simulation_interfaces/srv/DeleteEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/DeleteEntity_Request"

    entity: str = ""


class DeleteEntityResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/DeleteEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/DeleteEntity_Response"

    result: Result = Result()


class FilterMode(IntEnum):
    """How many of the tags must be there. Source: simulation_interfaces/msg/TagsFilter."""

    ANY = 0
    ALL = 1


class TagsFilter(msgspec.Struct, frozen=True):
    """Any or all of these tags. Source: simulation_interfaces/msg/TagsFilter."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/TagsFilter"

    tags: tuple[str, ...] = ()
    filter_mode: UInt8 = FilterMode.ANY


class BoundsType(IntEnum):
    """Shapes of a region. Source: simulation_interfaces/msg/Bounds."""

    EMPTY = 0
    BOX = 1
    CONVEX_HULL = 2
    SPHERE = 3


class Bounds(msgspec.Struct, frozen=True):
    """A region, in the frame that its owner names. Source: simulation_interfaces/msg/Bounds.

    By type: empty (unbounded), no points; box along the axes, its upper and its lower corner;
    convex hull, 3 points or more that are not on one line; sphere, its centre, and its radius as
    the x of a second point.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Bounds"

    type: UInt8 = BoundsType.EMPTY
    points: tuple[Vector3, ...] = ()


class EntityFilters(msgspec.Struct, frozen=True):
    """Which entities: those that pass all filters; an empty one lets all pass.

    `filter` is a POSIX extended regular expression found anywhere in the name; `bounds`, in the
    world frame, are overlapped by the entity. Source: simulation_interfaces/msg/EntityFilters.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityFilters"

    filter: str = ""
    categories: tuple[EntityCategory, ...] = ()
    tags: TagsFilter = TagsFilter()
    bounds: Bounds = Bounds()


class GetEntitiesRequest(msgspec.Struct, frozen=True):
    """Name the entities. Source: simulation_interfaces/srv/GetEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntities_Request"

    filters: EntityFilters = EntityFilters()


class GetEntitiesResponse(msgspec.Struct, frozen=True):
    """Names, in the order of spawning. Source: simulation_interfaces/srv/GetEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntities_Response"

    result: Result = Result()
    entities: tuple[str, ...] = ()


class EntityState(msgspec.Struct, frozen=True):
    """Pose and twist of an entity's base. Source: simulation_interfaces/msg/EntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/EntityState"

    header: Header = Header()
    pose: Pose = Pose()
    twist: Twist = Twist()
    acceleration: Accel = Accel()


class GetEntityStateRequest(msgspec.Struct, frozen=True):
    """Ask where one entity is. Source: simulation_interfaces/srv/GetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityState_Request"

    entity: str = ""


class GetEntityStateResponse(msgspec.Struct, frozen=True):
    """State in the world frame. Source: simulation_interfaces/srv/GetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetEntityState_Response"

    result: Result = Result()
    state: EntityState = EntityState()


class SetEntityStateRequest(msgspec.Struct, frozen=True):
    """Put an entity somewhere. Source: simulation_interfaces/srv/SetEntityState, 2.1."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityState_Request"

    entity: str = ""
    state: EntityState = EntityState()
    set_pose: bool = False
    set_twist: bool = False
    set_acceleration: bool = False


class SetEntityStateResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/SetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityState_Response"

    result: Result = Result()


class State(IntEnum):
    """What the simulation does. Source: simulation_interfaces/msg/SimulationState."""

    STOPPED = 0
    PLAYING = 1
    PAUSED = 2
    QUITTING = 3
    NO_WORLD = 4
    LOADING_WORLD = 5


class SimulationState(msgspec.Struct, frozen=True):
    """One of `State`. Source: simulation_interfaces/msg/SimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SimulationState"

    state: UInt8 = State.STOPPED


class GetSimulationStateRequest(msgspec.Struct, frozen=True):
    """Ask whether it plays. Source: simulation_interfaces/srv/GetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulationState_Request"


class GetSimulationStateResponse(msgspec.Struct, frozen=True):
    """The state. Source: simulation_interfaces/srv/GetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulationState_Response"

    state: SimulationState = SimulationState()
    result: Result = Result()


class SetSimulationStateRequest(msgspec.Struct, frozen=True):
    """Play or pause. Source: simulation_interfaces/srv/SetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetSimulationState_Request"

    state: SimulationState = SimulationState()


class SetSimulationStateResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/SetSimulationState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetSimulationState_Response"

    result: Result = Result()


class StepSimulationRequest(msgspec.Struct, frozen=True):
    """Advance a paused world by so many steps. Source: simulation_interfaces/srv/StepSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/StepSimulation_Request"

    steps: UInt64 = 1


class StepSimulationResponse(msgspec.Struct, frozen=True):
    """Sent when the last step is done. Source: simulation_interfaces/srv/StepSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/StepSimulation_Response"

    result: Result = Result()


class ResetScope(IntEnum):
    """What a reset touches, as bits. Source: simulation_interfaces/srv/ResetSimulation."""

    DEFAULT = 0
    TIME = 1
    STATE = 2
    SPAWNED = 4
    ALL = 255


class ResetSimulationRequest(msgspec.Struct, frozen=True):
    """Go back to the start. Source: simulation_interfaces/srv/ResetSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/ResetSimulation_Request"

    scope: UInt8 = ResetScope.DEFAULT


class ResetSimulationResponse(msgspec.Struct, frozen=True):
    """How it went. Source: simulation_interfaces/srv/ResetSimulation."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/ResetSimulation_Response"

    result: Result = Result()


class Feature(IntEnum):
    """What this simulator can do. Source: simulation_interfaces/msg/SimulatorFeatures."""

    SPAWNING = 0
    DELETING = 1
    NAMED_POSES = 2
    POSE_BOUNDS = 3
    ENTITY_TAGS = 4
    ENTITY_BOUNDS = 5
    ENTITY_BOUNDS_BOX = 6
    ENTITY_BOUNDS_CONVEX = 7
    ENTITY_CATEGORIES = 8
    SPAWNING_RESOURCE_STRING = 9
    ENTITY_STATE_GETTING = 10
    ENTITY_STATE_SETTING = 11
    ENTITY_INFO_GETTING = 12
    ENTITY_INFO_SETTING = 13
    SPAWNABLES = 14
    SIMULATION_RESET = 20
    SIMULATION_RESET_TIME = 21
    SIMULATION_RESET_STATE = 22
    SIMULATION_RESET_SPAWNED = 23
    SIMULATION_STATE_GETTING = 24
    SIMULATION_STATE_SETTING = 25
    SIMULATION_STATE_PAUSE = 26
    STEP_SIMULATION_SINGLE = 31
    STEP_SIMULATION_MULTIPLE = 32
    STEP_SIMULATION_ACTION = 33
    WORLD_LOADING = 40
    WORLD_RESOURCE_STRING = 41
    WORLD_TAGS = 42
    WORLD_UNLOADING = 43
    WORLD_INFO_GETTING = 44
    AVAILABLE_WORLDS = 45
    SPAWNING_ENTITIES = 50


class SimulatorFeatures(msgspec.Struct, frozen=True):
    """Features and spawn formats. Source: simulation_interfaces/msg/SimulatorFeatures."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SimulatorFeatures"

    features: tuple[UInt16, ...] = ()
    spawn_formats: tuple[str, ...] = ()
    custom_info: str = ""


class GetSimulatorFeaturesRequest(msgspec.Struct, frozen=True):
    """Ask what it can do. Source: simulation_interfaces/srv/GetSimulatorFeatures."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulatorFeatures_Request"


class GetSimulatorFeaturesResponse(msgspec.Struct, frozen=True):
    """The features. Source: simulation_interfaces/srv/GetSimulatorFeatures."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSimulatorFeatures_Response"

    features: SimulatorFeatures = SimulatorFeatures()
