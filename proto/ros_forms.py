"""Forms in which ROS 2 asks for some of our services beside that of simulation_interfaces 2.1.

simulation_interfaces 1.x is what humble, jazzy and kilted have; gazebo_msgs is what scripts written
for Gazebo Classic send.
"""

from collections.abc import Callable
from typing import Any, ClassVar

import msgspec

from zensim.proto.geometry import Pose, PoseStamped
from zensim.proto.header import Header
from zensim.proto.places import GetSpawnablesResponse, Spawnable
from zensim.proto.result import Result, ResultCode
from zensim.proto.services import (
    Bounds,
    DeleteEntityRequest,
    DeleteEntityResponse,
    EntityState,
    Resource,
    SetEntityStateRequest,
    SpawnEntityRequest,
    SpawnEntityResponse,
)
from zensim.proto.worlds import LoadWorldRequest


class SpawnEntityRequestV1(msgspec.Struct, frozen=True):
    """Put one entity into the world. Source: simulation_interfaces 1.x, srv/SpawnEntity."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SpawnEntity_Request"

    name: str = ""
    allow_renaming: bool = False
    uri: str = ""
    resource_string: str = ""
    entity_namespace: str = ""
    initial_pose: PoseStamped = PoseStamped()


class LoadWorldRequestV1(msgspec.Struct, frozen=True):
    """Load a world. Source: simulation_interfaces 1.x, srv/LoadWorld."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/LoadWorld_Request"

    uri: str = ""
    resource_string: str = ""
    fail_on_unsupported_element: bool = False
    ignore_missing_or_unsupported_assets: bool = False


class SetEntityStateRequestV1(msgspec.Struct, frozen=True):
    """Set pose and twist of an entity. Source: simulation_interfaces 1.x, srv/SetEntityState."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/SetEntityState_Request"

    entity: str = ""
    state: EntityState = EntityState()


class SpawnableV1(msgspec.Struct, frozen=True):
    """What can be spawned. Source: simulation_interfaces 1.x, msg/Spawnable."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Spawnable"

    uri: str = ""
    description: str = ""
    spawn_bounds: Bounds = Bounds()


class GetSpawnablesResponseV1(msgspec.Struct, frozen=True):
    """What can be spawned. Source: simulation_interfaces 1.x, srv/GetSpawnables."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSpawnables_Response"

    result: Result = Result()
    spawnables: tuple[SpawnableV1, ...] = ()


class GazeboSpawnEntityRequest(msgspec.Struct, frozen=True):
    """Put one entity into the world. Source: gazebo_msgs/srv/SpawnEntity."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SpawnEntity_Request"

    name: str = ""
    xml: str = ""
    robot_namespace: str = ""
    initial_pose: Pose = Pose()
    reference_frame: str = ""


class GazeboSpawnEntityResponse(msgspec.Struct, frozen=True):
    """How it went. Source: gazebo_msgs/srv/SpawnEntity."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SpawnEntity_Response"

    success: bool = False
    status_message: str = ""


class GazeboDeleteEntityRequest(msgspec.Struct, frozen=True):
    """Take an entity out. Source: gazebo_msgs/srv/DeleteEntity."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/DeleteEntity_Request"

    name: str = ""


class GazeboDeleteEntityResponse(msgspec.Struct, frozen=True):
    """How it went. Source: gazebo_msgs/srv/DeleteEntity."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/DeleteEntity_Response"

    success: bool = False
    status_message: str = ""


def our_request(request: msgspec.Struct) -> msgspec.Struct:
    """Say in our own words what a request of another form asks; ours comes back as it is."""
    change = REQUESTS.get(type(request))
    return request if change is None else change(request)


def their_response(response: msgspec.Struct, kind: type[msgspec.Struct]) -> msgspec.Struct:
    """Give a response of ours the form `kind`; one that has it comes back as it is."""
    change = RESPONSES.get(kind)
    return response if change is None else change(response)


def _spawn_v1(request: SpawnEntityRequestV1) -> SpawnEntityRequest:
    return SpawnEntityRequest(
        request.name,
        request.allow_renaming,
        Resource(request.uri, request.resource_string),
        request.entity_namespace,
        request.initial_pose,
    )


def _load_v1(request: LoadWorldRequestV1) -> LoadWorldRequest:
    return LoadWorldRequest(
        Resource(request.uri, request.resource_string),
        request.fail_on_unsupported_element,
        request.ignore_missing_or_unsupported_assets,
    )


def _set_state(request: SetEntityStateRequestV1) -> SetEntityStateRequest:
    return SetEntityStateRequest(request.entity, request.state, set_pose=True, set_twist=True)


def _spawn(request: GazeboSpawnEntityRequest) -> SpawnEntityRequest:
    return SpawnEntityRequest(
        name=request.name,
        entity_resource=Resource(resource_string=request.xml),
        entity_namespace=request.robot_namespace,
        initial_pose=PoseStamped(Header(frame_id=request.reference_frame), request.initial_pose),
    )


def _delete(request: GazeboDeleteEntityRequest) -> DeleteEntityRequest:
    return DeleteEntityRequest(request.name)


def _spawnables(response: GetSpawnablesResponse) -> GetSpawnablesResponseV1:
    return GetSpawnablesResponseV1(
        response.result, tuple(_spawnable(one) for one in response.spawnables)
    )


def _spawnable(one: Spawnable) -> SpawnableV1:
    return SpawnableV1(one.entity_resource.uri, one.description, one.spawn_bounds)


def _spawned(response: SpawnEntityResponse) -> GazeboSpawnEntityResponse:
    done = f"entity {response.entity_name!r} is spawned"
    return GazeboSpawnEntityResponse(*_told(response.result, done))


def _deleted(response: DeleteEntityResponse) -> GazeboDeleteEntityResponse:
    return GazeboDeleteEntityResponse(*_told(response.result, "the entity is deleted"))


def _told(result: Result, done: str) -> tuple[bool, str]:
    is_done = result.result == ResultCode.OK
    return is_done, done if is_done else result.error_message


REQUESTS: dict[type[msgspec.Struct], Callable[[Any], msgspec.Struct]] = {
    SpawnEntityRequestV1: _spawn_v1,
    LoadWorldRequestV1: _load_v1,
    SetEntityStateRequestV1: _set_state,
    GazeboSpawnEntityRequest: _spawn,
    GazeboDeleteEntityRequest: _delete,
}
RESPONSES: dict[type[msgspec.Struct], Callable[[Any], msgspec.Struct]] = {
    GetSpawnablesResponseV1: _spawnables,
    GazeboSpawnEntityResponse: _spawned,
    GazeboDeleteEntityResponse: _deleted,
}
