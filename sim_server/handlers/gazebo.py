"""Gazebo's own names for time and states; what stands behind them is that of the other services."""

from zensim.proto.messages import entity_messages, gazebo_messages
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import (
    ResetScope,
    SetSimulationStateRequest,
    SimulationState,
    State,
)
from zensim.proto.messages.standard_messages import Header, time_from_ns
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import Refused
from zensim.sim_server.handlers.states import set_state
from zensim.sim_server.handlers.transitions import set_simulation_state
from zensim.sim_server.lookup.frames import SCOPE, seen_from
from zensim.sim_server.lookup.scoped import link_of, state_of
from zensim.sim_server.world.poses import WORLD_FRAMES, pose_of, twist_of


def pause_physics(
    desk: Desk, _: gazebo_messages.PausePhysicsRequest
) -> gazebo_messages.EmptyReport:
    """Pause; paused already is fine, as it is to Gazebo."""
    return _go(desk, State.PAUSED)


def unpause_physics(
    desk: Desk, _: gazebo_messages.UnpausePhysicsRequest
) -> gazebo_messages.EmptyReport:
    """Play; playing already is fine, as it is to Gazebo."""
    return _go(desk, State.PLAYING)


def reset_world(desk: Desk, _: gazebo_messages.ResetWorldRequest) -> gazebo_messages.EmptyReport:
    """Put every entity back to its start; time goes on, and what was spawned stays."""
    desk.world.reset(ResetScope.STATE)
    return gazebo_messages.EmptyReport()


def get_entity_state(
    desk: Desk, request: gazebo_messages.GazeboGetEntityStateRequest
) -> gazebo_messages.GazeboGetEntityStateReport:
    """Tell where an entity or a link is, and how it moves against the frame."""
    row = state_of(desk.world, request.name)
    frame_id = request.reference_frame
    if frame_id not in WORLD_FRAMES:
        frame = state_of(desk.world, frame_id)
        row = row.copy()
        row[7:] -= frame[7:]
        row = seen_from(frame[:7], row[None])[0]
    frame_id = frame_id or "world"
    return gazebo_messages.GazeboGetEntityStateReport(
        Header(time_from_ns(desk.world.time_ns), frame_id),
        gazebo_messages.GazeboEntityState(request.name, pose_of(row), twist_of(row), frame_id),
        success=True,
    )


def set_entity_state(
    desk: Desk, request: gazebo_messages.GazeboSetEntityStateRequest
) -> gazebo_messages.GazeboSetEntityStateReport:
    """Put an entity somewhere; a link goes where its entity goes."""
    state = request.state
    name, scope, _ = state.name.partition(SCOPE)
    if scope and link_of(desk.world, state.name).number:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"link {state.name[:80]!r} hangs on joints and cannot be put anywhere by itself; "
            f"use '{name}'",
        )
    wanted = entity_messages.EntityState(
        Header(frame_id=state.reference_frame), state.pose, state.twist
    )
    set_state(
        desk, entity_messages.SetEntityStateRequest(name, wanted, set_pose=True, set_twist=True)
    )
    return gazebo_messages.GazeboSetEntityStateReport(success=True)


def _go(desk: Desk, state: State) -> gazebo_messages.EmptyReport:
    if desk.world.state != state:
        set_simulation_state(desk, SetSimulationStateRequest(SimulationState(state)))
    return gazebo_messages.EmptyReport(Result())
