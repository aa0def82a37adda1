"""Services that load, unload and list worlds, and the lights and colours of a world."""

from typing import ClassVar

import msgspec

from zensim.proto.messages.entity_messages import TagsFilter
from zensim.proto.messages.model_messages import Light, Quat, ReportEntry
from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.spawn_messages import Resource
from zensim.proto.messages.standard_messages import OccupancyGrid


class Scene(msgspec.Struct, frozen=True):
    """Colours and lights of a world; None = not specified."""

    ambient: Quat | None = None
    background: Quat | None = None
    lights: tuple[Light, ...] = ()
    """Poses and directions are in the world frame."""
    has_sun: bool = False
    """Whether it includes `model://sun`."""


class WorldResource(msgspec.Struct, frozen=True):
    """A world and its resource. Source: simulation_interfaces/msg/WorldResource."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/WorldResource"

    name: str = ""
    world_resource: Resource = Resource()
    description: str = ""
    tags: tuple[str, ...] = ()


class LoadWorldRequest(msgspec.Struct, frozen=True):
    """Replace the current world. Source: simulation_interfaces/srv/LoadWorld."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/LoadWorld_Request"

    world_resource: Resource = Resource()
    """`uri`: a built-in world or a file of the operator; else `resource_string`: SDF."""
    fail_on_unsupported_element: bool = False
    ignore_missing_or_unsupported_assets: bool = False


class LoadWorldResponse(msgspec.Struct, frozen=True):
    """The new world. Source: simulation_interfaces/srv/LoadWorld."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/LoadWorld_Response"

    result: Result = Result()
    world: WorldResource = WorldResource()


class LoadWorldReport(LoadWorldResponse, frozen=True):
    """Adds the report on the world file."""

    report: tuple[ReportEntry, ...] = ()


class GetMapRequest(msgspec.Struct, frozen=True):
    """Draw the fixed collisions of the world as an occupancy grid."""

    ros_type: ClassVar[str] = "zensim/srv/GetMap_Request"

    resolution_m: float = 0.05
    """Side of a cell."""
    low_m: float = 0.05
    """What is wholly below this height is left out."""
    high_m: float = 0.5
    """What is wholly above this height is left out."""


class GetMapResponse(msgspec.Struct, frozen=True):
    """The map: 0 is free, 100 is occupied."""

    ros_type: ClassVar[str] = "zensim/srv/GetMap_Response"

    result: Result = Result()
    map: OccupancyGrid = OccupancyGrid()


class UnloadWorldRequest(msgspec.Struct, frozen=True):
    """Remove the world and all entities. Source: simulation_interfaces/srv/UnloadWorld."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/UnloadWorld_Request"


class UnloadWorldResponse(msgspec.Struct, frozen=True):
    """Result of the request. Source: simulation_interfaces/srv/UnloadWorld."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/UnloadWorld_Response"

    result: Result = Result()


class GetCurrentWorldRequest(msgspec.Struct, frozen=True):
    """Get the current world. Source: simulation_interfaces/srv/GetCurrentWorld."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetCurrentWorld_Request"


class GetCurrentWorldResponse(msgspec.Struct, frozen=True):
    """The world, as it was requested. Source: simulation_interfaces/srv/GetCurrentWorld."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetCurrentWorld_Response"

    result: Result = Result()
    world: WorldResource = WorldResource()


class GetAvailableWorldsRequest(msgspec.Struct, frozen=True):
    """List the worlds that can be loaded. Source: simulation_interfaces/srv/GetAvailableWorlds."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetAvailableWorlds_Request"

    additional_sources: tuple[str, ...] = ()
    """Folders within those of the operator; others are refused."""
    filter: TagsFilter = TagsFilter()
    offline_only: bool = False
    """Skip online sources, which are never read."""
    continue_on_error: bool = False


class GetAvailableWorldsResponse(msgspec.Struct, frozen=True):
    """Worlds, by name. Source: simulation_interfaces/srv/GetAvailableWorlds."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetAvailableWorlds_Response"

    result: Result = Result()
    worlds: tuple[WorldResource, ...] = ()
