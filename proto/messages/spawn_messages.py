"""Services of simulation_interfaces 2.1: spawn, delete, spawnables, named poses."""

from typing import ClassVar, Final

import msgspec

from zensim.proto.messages import drive_messages
from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.entity_messages import Bounds, EntityInfo, TagsFilter
from zensim.proto.messages.model_messages import Dynamics, ReportEntry
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.standard_messages import Pose, PoseStamped

Compat = drive_messages.Compat


class Resource(msgspec.Struct, frozen=True):
    """A description by uri or as text. Source: simulation_interfaces/msg/Resource."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Resource"

    uri: str = ""
    resource_string: str = ""


class SpawnEntityRequest(msgspec.Struct, frozen=True):
    """Spawn an entity. Source: simulation_interfaces/srv/SpawnEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntity_Request"

    name: str = ""
    allow_renaming: bool = False
    entity_resource: Resource = Resource()
    entity_namespace: str = ""
    initial_pose: PoseStamped = PoseStamped()


class SpawnEntityOrder(SpawnEntityRequest, frozen=True):
    """Adds options that simulation_interfaces does not have."""

    snap_to_ground: bool = False
    """Move the entity along z until its lowest point touches z = 0."""
    strict: bool = False
    """Refuse a description that has suspicious entries in its report."""
    allow_missing: bool = False
    """Omit collisions whose mesh is not on the server."""
    dry_run: bool = False
    """Validate the request and return the report without spawning."""
    compat: Compat = "fixed"
    """Corrected behaviour of drives, or that of Gazebo 11 with its documented errors."""
    bond: str = ""
    """Name of the liveliness token `sim/<world>/bond/<name>` whose end deletes the entity."""
    assets: tuple[AssetRef, ...] = ()
    """Files of the uris in the description; upload them before with `put_asset`."""
    info: EntityInfo | None = None
    """None = derived from the description; see `set_entity_info`."""
    dynamics: Dynamics = ""
    """Empty = default of the world."""
    controllers: tuple[str, ...] = ()
    """Texts of parameter files (YAML) of ros2_controllers or ros_control; one drives the robot."""
    drive: DriveOrder = DriveOrder()
    """Used instead of controllers and of the drive of the description."""


class SpawnEntityResponse(msgspec.Struct, frozen=True):
    """Name of the entity. Source: simulation_interfaces/srv/SpawnEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntity_Response"

    result: Result = Result()
    entity_name: str = ""


class SpawnEntityReport(SpawnEntityResponse, frozen=True):
    """Adds the namespace and the report on the description."""

    entity_namespace: str = ""
    report: tuple[ReportEntry, ...] = ()
    drive: str = ""
    """Kind of the drive, such as `diff_drive`; empty = it has none."""


class DeleteEntityRequest(msgspec.Struct, frozen=True):
    """Delete an entity. Source: simulation_interfaces/srv/DeleteEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/DeleteEntity_Request"

    entity: str = ""


class DeleteEntityResponse(msgspec.Struct, frozen=True):
    """Result of the request. Source: simulation_interfaces/srv/DeleteEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/DeleteEntity_Response"

    result: Result = Result()


MAX_SPAWNS: Final = 10_000
"""Limit of one request."""
NOT_SPAWNED_PREFIX: Final = "not spawned because of"
"""Begin of the error messages of valid requests in an atomic spawn that failed."""


class SpawnEntity(msgspec.Struct, frozen=True):
    """One entity of many. Source: simulation_interfaces/msg/SpawnEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SpawnEntity"

    name: str = ""
    allow_renaming: bool = False
    entity_resource: Resource = Resource()
    entity_namespace: str = ""
    initial_pose: PoseStamped = PoseStamped()


class SpawnEntitiesRequest(msgspec.Struct, frozen=True):
    """Spawn entities. Source: simulation_interfaces/srv/SpawnEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntities_Request"

    spawn_requests: tuple[SpawnEntity, ...] = ()


class SpawnEntitiesOrder(SpawnEntitiesRequest, frozen=True):
    """Adds options that simulation_interfaces does not have."""

    atomic: bool = False
    """Spawn all entities between two steps, or none."""
    common: SpawnEntityOrder = SpawnEntityOrder()
    """Options of all entities, and the resource of those without one.

    Its name, namespace and pose are ignored.
    """


class SpawnResult(msgspec.Struct, frozen=True):
    """Result for one entity. Source: simulation_interfaces/msg/SpawnResult."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SpawnResult"

    result: Result = Result()
    entity_name: str = ""


class SpawnEntitiesResponse(msgspec.Struct, frozen=True):
    """One result for each request, in order. Source: simulation_interfaces/srv/SpawnEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntities_Response"

    result: Result = Result()
    results: tuple[SpawnResult, ...] = ()


class Spawnable(msgspec.Struct, frozen=True):
    """A description that can be spawned by uri. Source: simulation_interfaces/msg/Spawnable."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Spawnable"

    entity_resource: Resource = Resource()
    description: str = ""
    spawn_bounds: Bounds = Bounds()
    """Bounds of its collisions in the frame of its base link, with all joints at zero."""


class GetSpawnablesRequest(msgspec.Struct, frozen=True):
    """List spawnable descriptions. Source: simulation_interfaces/srv/GetSpawnables."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSpawnables_Request"

    sources: tuple[str, ...] = ()
    """Only `zensim://` is supported: the built-in robots, which are always listed."""


class GetSpawnablesResponse(msgspec.Struct, frozen=True):
    """Spawnable descriptions. Source: simulation_interfaces/srv/GetSpawnables."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSpawnables_Response"

    result: Result = Result()
    spawnables: tuple[Spawnable, ...] = ()


class NamedPose(msgspec.Struct, frozen=True):
    """A pose in the world with a name. Source: simulation_interfaces/msg/NamedPose."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/NamedPose"

    name: str = ""
    description: str = ""
    tags: tuple[str, ...] = ()
    pose: Pose = Pose()


class GetNamedPosesRequest(msgspec.Struct, frozen=True):
    """List the named poses. Source: simulation_interfaces/srv/GetNamedPoses."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetNamedPoses_Request"

    tags: TagsFilter = TagsFilter()


class GetNamedPosesResponse(msgspec.Struct, frozen=True):
    """Named poses of the world, in order. Source: simulation_interfaces/srv/GetNamedPoses."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetNamedPoses_Response"

    result: Result = Result()
    poses: tuple[NamedPose, ...] = ()


class GetNamedPoseBoundsRequest(msgspec.Struct, frozen=True):
    """Get the free space of a named pose. Source: simulation_interfaces/srv/GetNamedPoseBounds."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetNamedPoseBounds_Request"

    name: str = ""


class GetNamedPoseBoundsResponse(msgspec.Struct, frozen=True):
    """Bounds in the frame of the pose; empty = unbounded.

    Source: simulation_interfaces/srv/GetNamedPoseBounds.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetNamedPoseBounds_Response"

    result: Result = Result()
    bounds: Bounds = Bounds()
