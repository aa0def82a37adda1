"""Poses and twists of entities, in the world or in any entity's frame."""

from proto import services
from proto.header import Header, time_from_ns
from proto.result import SetEntityStateCode
from sim_server.desk import Desk
from sim_server.errors import PoseRefused, Refused, Unsupported
from sim_server.physics.engine import FloatArray
from sim_server.poses import WORLD_FRAMES, pose_of, pose_row, turned, twist_of, twist_row
from sim_server.spawning import in_world
from sim_server.world import World


def get_state(
    desk: Desk, request: services.GetEntityStateRequest
) -> services.GetEntityStateResponse:
    """Tell where an entity is."""
    row = desk.world.state_of(request.entity)
    header = Header(time_from_ns(desk.world.time_ns), "world")
    return services.GetEntityStateResponse(
        state=services.EntityState(header, pose_of(row), twist_of(row))
    )


def set_state(
    desk: Desk, request: services.SetEntityStateRequest
) -> services.SetEntityStateResponse:
    """Put an entity somewhere."""
    row = desk.world.state_of(request.entity).copy()
    # A request of version 1 has no flags and means both.
    is_version_1 = not (request.set_pose or request.set_twist or request.set_acceleration)
    if request.set_acceleration:
        raise Unsupported("acceleration cannot be set; set the pose or the twist")
    try:
        if request.set_pose or is_version_1:
            pose = pose_row(request.state.pose)
            row[:7] = in_world(desk.world, request.state.header.frame_id, pose)
        if request.set_twist or is_version_1:
            twist = twist_row(request.state.twist)
            row[7:13] = _twist_in_world(desk.world, request.state.header.frame_id, twist)
    except PoseRefused as error:
        raise Refused(SetEntityStateCode.INVALID_POSE, str(error)) from error
    desk.world.place(request.entity, row)
    return services.SetEntityStateResponse()


def _twist_in_world(world: World, frame_id: str, twist: FloatArray) -> FloatArray:
    """Turn a twist (6,) with the axes of a frame; how the frame moves itself is left out."""
    if frame_id in WORLD_FRAMES:
        return twist
    return turned(world.state_of(frame_id)[:7], twist)
