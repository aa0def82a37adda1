"""Services that spawn and delete entities, one or many, and list spawnables and named poses (simulation_interfaces 2.1)."""

from typing import ClassVar, Final

import msgspec

from zensim.proto.messages import drive_messages
from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.entity_messages import Bounds, EntityInfo, TagsFilter
from zensim.proto.messages.model_messages import Dynamics, ReportEntry
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.standard_messages import Pose, PoseStamped

Compat = drive_messages.Compat


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


MAX_SPAWNS: Final = 10_000
"""In one request."""
NOT_SPAWNED_PREFIX: Final = "not spawned because of"
"""How the messages begin of those that could have been spawned, when all or none were."""


class SpawnEntity(msgspec.Struct, frozen=True):
    """One entity of many. Source: simulation_interfaces/msg/SpawnEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SpawnEntity"

    name: str = ""
    allow_renaming: bool = False
    entity_resource: Resource = Resource()
    entity_namespace: str = ""
    initial_pose: PoseStamped = PoseStamped()


class SpawnEntitiesRequest(msgspec.Struct, frozen=True):
    """Put entities into the world. Source: simulation_interfaces/srv/SpawnEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntities_Request"

    spawn_requests: tuple[SpawnEntity, ...] = ()


class SpawnEntitiesOrder(SpawnEntitiesRequest, frozen=True):
    """The same with wishes that simulation_interfaces has no field for."""

    atomic: bool = False
    """All of them between two steps, or none of them."""
    common: SpawnEntityOrder = SpawnEntityOrder()
    """What holds for all: the resource of those that name none, and every wish of a single spawn.

    Its name, namespace and pose count for nothing.
    """


class SpawnResult(msgspec.Struct, frozen=True):
    """What became of one entity. Source: simulation_interfaces/msg/SpawnResult."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/SpawnResult"

    result: Result = Result()
    entity_name: str = ""


class SpawnEntitiesResponse(msgspec.Struct, frozen=True):
    """One result for each request, in order. Source: simulation_interfaces/srv/SpawnEntities."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntities_Response"

    result: Result = Result()
    results: tuple[SpawnResult, ...] = ()


class Spawnable(msgspec.Struct, frozen=True):
    """A description that a spawn may name. Source: simulation_interfaces/msg/Spawnable."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Spawnable"

    entity_resource: Resource = Resource()
    description: str = ""
    spawn_bounds: Bounds = Bounds()
    """Of its collisions in the frame of its base link, joints at zero."""


class GetSpawnablesRequest(msgspec.Struct, frozen=True):
    """Ask what can be spawned. Source: simulation_interfaces/srv/GetSpawnables."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSpawnables_Request"

    sources: tuple[str, ...] = ()
    """Only `zensim://` is known: the robots that come with the server, listed anyway."""


class GetSpawnablesResponse(msgspec.Struct, frozen=True):
    """What can be spawned by uri. Source: simulation_interfaces/srv/GetSpawnables."""

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
    """Ask for the named poses. Source: simulation_interfaces/srv/GetNamedPoses."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetNamedPoses_Request"

    tags: TagsFilter = TagsFilter()


class GetNamedPosesResponse(msgspec.Struct, frozen=True):
    """Those of the world in order. Source: simulation_interfaces/srv/GetNamedPoses."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetNamedPoses_Response"

    result: Result = Result()
    poses: tuple[NamedPose, ...] = ()


class GetNamedPoseBoundsRequest(msgspec.Struct, frozen=True):
    """Ask how much room a named pose has. Source: simulation_interfaces/srv/GetNamedPoseBounds."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetNamedPoseBounds_Request"

    name: str = ""


class GetNamedPoseBoundsResponse(msgspec.Struct, frozen=True):
    """In the frame of the pose; empty = unbounded.

    Source: simulation_interfaces/srv/GetNamedPoseBounds.
    """

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetNamedPoseBounds_Response"

    result: Result = Result()
    bounds: Bounds = Bounds()
