"""Poses and twists of entities, in the world or in any frame."""

from collections.abc import Sequence

import numpy as np

from zensim.proto.messages import entity_messages
from zensim.proto.messages.result_messages import SetEntityStateCode
from zensim.proto.messages.standard_messages import Header, time_from_ns
from zensim.proto.rotation import FloatArray
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import PoseRefused, Refused, Unsupported
from zensim.sim_server.later import Later
from zensim.sim_server.lookup.filters import passing
from zensim.sim_server.lookup.frames import frame_pose, in_world, seen_from, twist_in_world
from zensim.sim_server.world.poses import WORLD_FRAMES, pose_of, pose_row, twist_of, twist_row
from zensim.sim_server.world.world import World


def get_state(
    desk: Desk, request: entity_messages.GetEntityStateOrder
) -> entity_messages.GetEntityStateResponse:
    """Tell where an entity is; accelerations are not measured and told as 0.

    In the world's frame it is where agents were told that it is, at their last control step.
    """
    world = desk.world
    if request.reference_frame in WORLD_FRAMES:
        row, time_ns = world.told_of(request.entity)
        header = Header(time_from_ns(time_ns), "world")
        return entity_messages.GetEntityStateResponse(state=_state(header, row))
    row = world.state_of(request.entity)
    (state,) = _View(world, request.reference_frame).states(row[None])
    return entity_messages.GetEntityStateResponse(state=state)


def get_states(
    desk: Desk, request: entity_messages.GetEntitiesStatesOrder
) -> entity_messages.GetEntitiesStatesResponse | Later:
    """Tell where the entities are that pass the filters, all at one step."""
    view = _View(desk.world, request.reference_frame)
    base, row = desk.world.reading().base, desk.world.roster().row

    def answer(names: tuple[str, ...]) -> entity_messages.GetEntitiesStatesResponse:
        states = view.states(base[[row[name] for name in names]]) if names else []
        return entity_messages.GetEntitiesStatesResponse(entities=names, states=tuple(states))

    return passing(desk, request.filters, answer)


class _View:
    """Entities as seen from a frame, at one step; how the frame moves itself is left out."""

    def __init__(self, world: World, frame_id: str) -> None:
        self._frame = None if frame_id in WORLD_FRAMES else frame_pose(world, frame_id)
        name = "world" if self._frame is None else frame_id
        self._header = Header(time_from_ns(world.time_ns), name)

    def states(self, rows: FloatArray) -> Sequence[entity_messages.EntityState]:
        """Write state rows (n, 13) of the world down."""
        if self._frame is not None:
            rows = seen_from(self._frame, rows)
        return [_state(self._header, row) for row in rows]


def _state(header: Header, row: FloatArray) -> entity_messages.EntityState:
    return entity_messages.EntityState(header, pose_of(row), twist_of(row))


def set_state(
    desk: Desk, request: entity_messages.SetEntityStateRequest
) -> entity_messages.SetEntityStateResponse:
    """Put an entity somewhere."""
    row = desk.world.state_of(request.entity).copy()
    # A request of version 1 has no flags and means both.
    is_version_1 = not (request.set_pose or request.set_twist or request.set_acceleration)
    if request.set_acceleration:
        raise Unsupported(
            "acceleration cannot be set: it follows from forces; set the pose or the twist"
        )
    frame_id = request.state.header.frame_id
    try:
        if request.set_pose or is_version_1:
            row[:7] = in_world(desk.world, frame_id, pose_row(request.state.pose))
        if request.set_twist or is_version_1:
            row[7:13] = twist_in_world(desk.world, frame_id, twist_row(request.state.twist))
    except PoseRefused as error:
        raise Refused(SetEntityStateCode.INVALID_POSE, str(error)) from error
    desk.world.place(request.entity, np.asarray(row))
    return entity_messages.SetEntityStateResponse()
