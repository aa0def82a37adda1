"""What can be spawned, and the named poses of the world. simulation_interfaces 2.1."""

from typing import ClassVar

import msgspec

from zensim.proto.geometry import Pose
from zensim.proto.result import Result
from zensim.proto.services import Bounds, Resource, TagsFilter


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
