"""Types of simulation_interfaces 1.x and gazebo_msgs, and their conversion to and from ours."""

from collections.abc import Callable
from typing import Any, ClassVar

import msgspec

from zensim.proto.messages.entity_messages import Bounds, EntityState, SetEntityStateRequest
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    DeleteEntityResponse,
    GetSpawnablesResponse,
    Resource,
    Spawnable,
    SpawnEntityRequest,
    SpawnEntityResponse,
)
from zensim.proto.messages.standard_messages import Header, Pose, PoseStamped
from zensim.proto.messages.world_messages import LoadWorldRequest


class SpawnEntityRequestV1(msgspec.Struct, frozen=True):
    """Spawn an entity. Source: simulation_interfaces 1.x, srv/SpawnEntity."""

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
    """Spawnable descriptions. Source: simulation_interfaces 1.x, msg/Spawnable."""

    ros_type: ClassVar[str] = "simulation_interfaces/msg/Spawnable"

    uri: str = ""
    description: str = ""
    spawn_bounds: Bounds = Bounds()


class GetSpawnablesResponseV1(msgspec.Struct, frozen=True):
    """Spawnable descriptions. Source: simulation_interfaces 1.x, srv/GetSpawnables."""

    ros_type: ClassVar[str] = "simulation_interfaces/srv/GetSpawnables_Response"

    result: Result = Result()
    spawnables: tuple[SpawnableV1, ...] = ()


class GazeboSpawnEntityRequest(msgspec.Struct, frozen=True):
    """Spawn an entity. Source: gazebo_msgs/srv/SpawnEntity."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SpawnEntity_Request"

    name: str = ""
    xml: str = ""
    robot_namespace: str = ""
    initial_pose: Pose = Pose()
    reference_frame: str = ""


class GazeboSpawnEntityResponse(msgspec.Struct, frozen=True):
    """Result of the request. Source: gazebo_msgs/srv/SpawnEntity."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/SpawnEntity_Response"

    success: bool = False
    status_message: str = ""


class GazeboDeleteEntityRequest(msgspec.Struct, frozen=True):
    """Delete an entity. Source: gazebo_msgs/srv/DeleteEntity."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/DeleteEntity_Request"

    name: str = ""


class GazeboDeleteEntityResponse(msgspec.Struct, frozen=True):
    """Result of the request. Source: gazebo_msgs/srv/DeleteEntity."""

    ros_type: ClassVar[str] = "gazebo_msgs/srv/DeleteEntity_Response"

    success: bool = False
    status_message: str = ""


def adapt_request(request: msgspec.Struct) -> msgspec.Struct:
    """Convert a request of another version; a request of the catalog is returned unchanged."""
    adapt = REQUEST_ADAPTERS.get(type(request))
    return request if adapt is None else adapt(request)


def adapt_response(response: msgspec.Struct, kind: type[msgspec.Struct]) -> msgspec.Struct:
    """Convert a response of the catalog to `kind`; unchanged if that is its type."""
    adapt = RESPONSE_ADAPTERS.get(kind)
    return response if adapt is None else adapt(response)


def _adapt_spawn_v1(request: SpawnEntityRequestV1) -> SpawnEntityRequest:
    return SpawnEntityRequest(
        request.name,
        request.allow_renaming,
        Resource(request.uri, request.resource_string),
        request.entity_namespace,
        request.initial_pose,
    )


def _adapt_load_v1(request: LoadWorldRequestV1) -> LoadWorldRequest:
    return LoadWorldRequest(
        Resource(request.uri, request.resource_string),
        request.fail_on_unsupported_element,
        request.ignore_missing_or_unsupported_assets,
    )


def _adapt_set_state_v1(request: SetEntityStateRequestV1) -> SetEntityStateRequest:
    return SetEntityStateRequest(request.entity, request.state, set_pose=True, set_twist=True)


def _adapt_gazebo_spawn(request: GazeboSpawnEntityRequest) -> SpawnEntityRequest:
    return SpawnEntityRequest(
        name=request.name,
        entity_resource=Resource(resource_string=request.xml),
        entity_namespace=request.robot_namespace,
        initial_pose=PoseStamped(Header(frame_id=request.reference_frame), request.initial_pose),
    )


def _adapt_gazebo_delete(request: GazeboDeleteEntityRequest) -> DeleteEntityRequest:
    return DeleteEntityRequest(request.name)


def _to_spawnables_v1(response: GetSpawnablesResponse) -> GetSpawnablesResponseV1:
    return GetSpawnablesResponseV1(
        response.result, tuple(_to_spawnable_v1(one) for one in response.spawnables)
    )


def _to_spawnable_v1(one: Spawnable) -> SpawnableV1:
    return SpawnableV1(one.entity_resource.uri, one.description, one.spawn_bounds)


def _to_gazebo_spawned(response: SpawnEntityResponse) -> GazeboSpawnEntityResponse:
    done = f"entity {response.entity_name!r} is spawned"
    return GazeboSpawnEntityResponse(*_to_success(response.result, done))


def _to_gazebo_deleted(response: DeleteEntityResponse) -> GazeboDeleteEntityResponse:
    return GazeboDeleteEntityResponse(*_to_success(response.result, "the entity is deleted"))


def _to_success(result: Result, done: str) -> tuple[bool, str]:
    is_done = result.result == ResultCode.OK
    return is_done, done if is_done else result.error_message


REQUEST_ADAPTERS: dict[type[msgspec.Struct], Callable[[Any], msgspec.Struct]] = {
    SpawnEntityRequestV1: _adapt_spawn_v1,
    LoadWorldRequestV1: _adapt_load_v1,
    SetEntityStateRequestV1: _adapt_set_state_v1,
    GazeboSpawnEntityRequest: _adapt_gazebo_spawn,
    GazeboDeleteEntityRequest: _adapt_gazebo_delete,
}
RESPONSE_ADAPTERS: dict[type[msgspec.Struct], Callable[[Any], msgspec.Struct]] = {
    GetSpawnablesResponseV1: _to_spawnables_v1,
    GazeboSpawnEntityResponse: _to_gazebo_spawned,
    GazeboDeleteEntityResponse: _to_gazebo_deleted,
}
