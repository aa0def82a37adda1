"""Services of Gazebo classic: states, pause, wrenches and efforts, joint and link properties."""

import math
from collections.abc import Callable
from functools import partial

import msgspec
import numpy as np

from zensim.proto.messages import entity_messages, gazebo_messages
from zensim.proto.messages.gazebo_messages import JointType
from zensim.proto.messages.model_messages import LIMITED_KINDS, Inertial, Joint, Link
from zensim.proto.messages.result_messages import Result, ResultCode
from zensim.proto.messages.simulation_messages import (
    ResetScope,
    SetSimulationStateRequest,
    SimulationState,
    State,
)
from zensim.proto.messages.standard_messages import (
    Header,
    Point,
    Pose,
    Quaternion,
    Vector3,
    ns_from_time,
    time_from_ns,
)
from zensim.proto.se3 import FloatArray, conjugate, rotate, transform_points
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.queries.frame_queries import (
    SCOPE_SEPARATOR,
    ScopedJoint,
    ScopedLink,
    find_frame_pose,
    find_joint,
    find_link,
    find_state,
    states_to_frame,
)
from zensim.sim_server.service_parts import Pacing
from zensim.sim_server.services.entity_services import set_entity_state
from zensim.sim_server.services.simulation_services import set_simulation_state
from zensim.sim_server.world.applied_forces import JointEffort, LinkWrench, TimeSpan, make_time_span
from zensim.sim_server.world.pose_conversion import (
    MAX_POSITION_M,
    WORLD_FRAMES,
    pose_from_row,
    pose_to_row,
    twist_from_row,
)
from zensim.sim_server.world.simulated_world import SimulatedWorld

MAX_FORCE = 1e6
"""Largest force [N], torque or effort [N m]."""


def apply_link_wrench(
    world: SimulatedWorld, request: gazebo_messages.ApplyLinkWrenchRequest
) -> gazebo_messages.ApplyLinkWrenchReport:
    """Apply a wrench to a link, with constant direction in the world."""
    target = find_link(world, request.link_name)
    force, torque = (
        _to_vector(request.wrench.force, "force"),
        _to_vector(request.wrench.torque, "torque"),
    )
    wrench = _wrench_at_com(world, target, request, force, torque)
    status = _apply(world, request, partial(LinkWrench, target.entity.name, target.number, wrench))
    return gazebo_messages.ApplyLinkWrenchReport(success=True, status_message=status)


def clear_link_wrenches(
    world: SimulatedWorld, request: gazebo_messages.ClearLinkWrenchesRequest
) -> gazebo_messages.ClearLinkWrenchesReport:
    """Remove all wrenches of a link, if there are any."""
    target = find_link(world, request.link_name)
    world.applied_forces.clear_link(target.entity.name, target.number)
    return gazebo_messages.ClearLinkWrenchesReport()


def apply_joint_effort(
    world: SimulatedWorld, request: gazebo_messages.ApplyJointEffortRequest
) -> gazebo_messages.ApplyJointEffortReport:
    """Apply an effort along the axis of a joint."""
    target = find_joint(world, request.joint_name)
    if target.joint.kind == "fixed":
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"joint {request.joint_name[:80]!r} is fixed; name one that moves",
        )
    (effort,) = _check_range((request.effort,), "effort")
    status = _apply(world, request, partial(JointEffort, target.entity.name, target.number, effort))
    return gazebo_messages.ApplyJointEffortReport(success=True, status_message=status)


def clear_joint_efforts(
    world: SimulatedWorld, request: gazebo_messages.ClearJointEffortsRequest
) -> gazebo_messages.ClearJointEffortsReport:
    """Remove all efforts of a joint, if there are any."""
    target = find_joint(world, request.joint_name)
    world.applied_forces.clear_joint(target.entity.name, target.number)
    return gazebo_messages.ClearJointEffortsReport()


def _wrench_at_com(
    world: SimulatedWorld,
    target: ScopedLink,
    request: gazebo_messages.ApplyLinkWrenchRequest,
    force: FloatArray,
    torque: FloatArray,
) -> FloatArray:
    """Convert a wrench at a point of a frame to one at the centre of mass, in world axes, (6,)."""
    point = _to_vector(request.reference_point, "reference_point", MAX_POSITION_M)
    if request.reference_frame in WORLD_FRAMES:
        return np.concatenate([force, torque + np.cross(point, force)])
    frame = find_frame_pose(world, request.reference_frame)
    force, torque = rotate(frame[3:], force), rotate(frame[3:], torque)
    link = find_state(world, f"{target.entity.name}::{target.link.name}")
    mass = transform_points(link[:7], np.array(target.link.inertial.com_in_link))
    arm = transform_points(frame, point) - mass
    return np.concatenate([force, torque + np.cross(arm, force)])


def _apply(
    world: SimulatedWorld,
    request: gazebo_messages.ApplyLinkWrenchRequest | gazebo_messages.ApplyJointEffortRequest,
    make: Callable[[TimeSpan], LinkWrench | JointEffort],
) -> str:
    """Apply a force for the time of a request; return when it acts."""
    span = make_time_span(
        now_ns=world.clock.time_ns,
        start_ns=ns_from_time(request.start_time),
        duration_ns=ns_from_time(request.duration),
    )
    if span is None:
        return "duration 0: nothing done"
    world.applied_forces.add(make(span))
    end = "for ever" if span.end_ns is None else f"to {span.end_ns * 1e-9:.9g} s"
    return f"from {span.start_ns * 1e-9:.9g} s {end} of simulation time"


def _to_vector(vector: Vector3 | Point, what: str, most: float = MAX_FORCE) -> FloatArray:
    return np.array(_check_range((vector.x, vector.y, vector.z), what, most))


def _check_range(
    numbers: tuple[float, ...], what: str, most: float = MAX_FORCE
) -> tuple[float, ...]:
    for number in numbers:
        if not (math.isfinite(number) and abs(number) <= most):
            raise RequestRefused(
                ResultCode.OPERATION_FAILED,
                f"{what} {number:g} is out of range; use a finite number, {most:g} at most",
            )
    return numbers


JOINT_TYPES = {
    "revolute": JointType.REVOLUTE,
    "continuous": JointType.CONTINUOUS,
    "prismatic": JointType.PRISMATIC,
    "fixed": JointType.FIXED,
}
ODE_FIELDS = ("erp", "cfm", "stop_erp", "stop_cfm", "fudge_factor", "vel")
"""Settings of the ODE solver, which no engine here uses."""
MAX_PROPERTY = 1e6


def get_joint_properties(
    world: SimulatedWorld, request: gazebo_messages.GetJointPropertiesRequest
) -> gazebo_messages.GetJointPropertiesReport:
    """Return parameters, position and velocity of a joint."""
    target = find_joint(world, request.joint_name)
    joint = target.joint
    if joint.kind == "fixed":
        return gazebo_messages.GetJointPropertiesReport(type=JointType.FIXED, success=True)
    states = world.states()
    index = world.entities.index.joints_of(target.entity.name).start + target.number
    is_limited = joint.kind in LIMITED_KINDS
    return gazebo_messages.GetJointPropertiesReport(
        type=JOINT_TYPES[joint.kind],
        damping=(joint.damping,),
        position=(float(states.joint_positions[index]),),
        rate=(float(states.joint_velocities[index]),),
        success=True,
        lower=(joint.lower,) if is_limited else (),
        upper=(joint.upper,) if is_limited else (),
        friction=(joint.friction,),
    )


def set_joint_properties(
    world: SimulatedWorld, request: gazebo_messages.SetJointPropertiesRequest
) -> gazebo_messages.SetJointPropertiesReport:
    """Set damping, friction and limits of a joint."""
    target = find_joint(world, request.joint_name)
    _change_joint(world, target, _apply_joint_request(target.joint, request))
    return gazebo_messages.SetJointPropertiesReport(success=True)


def get_link_properties(
    world: SimulatedWorld, request: gazebo_messages.GetLinkPropertiesRequest
) -> gazebo_messages.GetLinkPropertiesReport:
    """Return mass and inertia of a link; the moments are about the axes of the link."""
    link = find_link(world, request.link_name).link
    return gazebo_messages.GetLinkPropertiesReport(
        Pose(Point(*link.inertial.com_in_link), Quaternion()),
        link.weightless == Inertial(),
        link.inertial.mass_kg,
        *link.inertial.inertia,
        success=True,
    )


def set_link_properties(
    world: SimulatedWorld, request: gazebo_messages.SetLinkPropertiesRequest
) -> gazebo_messages.SetLinkPropertiesReport:
    """Set mass and inertia of a link, and whether gravity acts on it."""
    target = find_link(world, request.link_name)
    if target.entity.model.is_static and target.number == 0:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"link {request.link_name[:80]!r} has no mass in a static model; use a link that moves",
        )
    inertial = _to_inertial(request)
    weightless = Inertial() if request.gravity_mode else inertial
    _change_link(
        world,
        target,
        msgspec.structs.replace(target.link, inertial=inertial, weightless=weightless),
    )
    return gazebo_messages.SetLinkPropertiesReport(success=True)


def _change_joint(world: SimulatedWorld, target: ScopedJoint, joint: Joint) -> None:
    joints = list(target.entity.model.joints)
    joints[target.number] = joint
    model = msgspec.structs.replace(target.entity.model, joints=tuple(joints))
    if model != target.entity.model:
        world.replace_model(target.entity.name, model)


def _change_link(world: SimulatedWorld, target: ScopedLink, link: Link) -> None:
    links = list(target.entity.model.links)
    links[target.number] = link
    model = msgspec.structs.replace(target.entity.model, links=tuple(links))
    if model != target.entity.model:
        world.replace_model(target.entity.name, model)


def _apply_joint_request(joint: Joint, request: gazebo_messages.SetJointPropertiesRequest) -> Joint:
    wanted, name = request.ode_joint_config, request.joint_name[:80]
    for field in ODE_FIELDS:
        if getattr(wanted, field):
            raise RequestRefused(
                ResultCode.FEATURE_UNSUPPORTED,
                f"{field} of joint {name!r} belongs to the ODE solver; set damping, fmax, lo_stop, "
                "hi_stop and leave the others empty",
            )
    if joint.kind == "fixed" and wanted != gazebo_messages.ODEJointProperties():
        raise RequestRefused(
            ResultCode.OPERATION_FAILED, f"joint {name!r} is fixed; nothing can be set"
        )
    lower, upper = _read_single(wanted.lo_stop, "lo_stop"), _read_single(wanted.hi_stop, "hi_stop")
    damping, friction = _read_single(wanted.damping, "damping"), _read_single(wanted.fmax, "fmax")
    for what, number in (("damping", damping), ("fmax", friction)):
        if number is not None and number < 0.0:
            raise RequestRefused(
                ResultCode.OPERATION_FAILED, f"{what} {number:g} is negative; use 0 or more"
            )
    if (lower, upper) != (None, None):
        _check_limits(joint, name, lower, upper)
    return msgspec.structs.replace(
        joint,
        damping=joint.damping if damping is None else damping,
        friction=joint.friction if friction is None else friction,
        lower=joint.lower if lower is None else lower,
        upper=joint.upper if upper is None else upper,
    )


def _check_limits(joint: Joint, name: str, lower: float | None, upper: float | None) -> None:
    if joint.kind not in LIMITED_KINDS:
        raise RequestRefused(
            ResultCode.FEATURE_UNSUPPORTED,
            f"joint {name!r} is {joint.kind} and has no limits; make it revolute in its model",
        )
    low = joint.lower if lower is None else lower
    high = joint.upper if upper is None else upper
    if low > high:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"lo_stop {low:g} of joint {name!r} is above hi_stop {high:g}; set both",
        )


def _read_single(numbers: tuple[float, ...], what: str) -> float | None:
    if not numbers:
        return None
    if len(numbers) > 1 or not math.isfinite(numbers[0]) or abs(numbers[0]) > MAX_PROPERTY:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"{what} has {len(numbers)} numbers, the first {numbers[0]:g}; "
            f"use one finite number, {MAX_PROPERTY:g} at most: each joint here has one axis",
        )
    return numbers[0]


def _to_inertial(request: gazebo_messages.SetLinkPropertiesRequest) -> Inertial:
    moments = (request.ixx, request.ixy, request.ixz, request.iyy, request.iyz, request.izz)
    numbers = (request.mass, *moments)
    if not all(math.isfinite(number) and abs(number) <= MAX_PROPERTY for number in numbers):
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"mass or a moment is out of range; use finite numbers, {MAX_PROPERTY:g} at most",
        )
    if request.mass <= 0.0:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED, f"mass {request.mass:g} is not positive; set all fields"
        )
    com = pose_to_row(request.com)
    ixx, ixy, ixz, iyy, iyz, izz = moments
    matrix = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    if float(np.linalg.eigvalsh(matrix).min()) < 0.0:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            "a moment of inertia is negative; use the moments of a real body",
        )
    # The request has moments about the axes of `com`, a model about those of the link.
    axes = rotate(conjugate(com[3:]), np.eye(3))
    turned = axes @ matrix @ axes.T
    x, y, z = com[:3].tolist()
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = turned.tolist()
    return Inertial(request.mass, (x, y, z), (xx, xy, xz, yy, yz, zz))


def pause_physics(
    world: SimulatedWorld, pacing: Pacing, _: gazebo_messages.PausePhysicsRequest
) -> gazebo_messages.EmptyReport:
    """Pause; no error if paused already, as in Gazebo."""
    return _change_state(world, pacing, State.PAUSED)


def unpause_physics(
    world: SimulatedWorld, pacing: Pacing, _: gazebo_messages.UnpausePhysicsRequest
) -> gazebo_messages.EmptyReport:
    """Play; no error if playing already, as in Gazebo."""
    return _change_state(world, pacing, State.PLAYING)


def reset_world(
    world: SimulatedWorld, _: gazebo_messages.ResetWorldRequest
) -> gazebo_messages.EmptyReport:
    """Reset the states of all entities; time and spawned entities stay."""
    world.reset(ResetScope.STATE)
    return gazebo_messages.EmptyReport()


def reset_gazebo_simulation(
    world: SimulatedWorld, _: gazebo_messages.GazeboResetSimulationRequest
) -> gazebo_messages.EmptyReport:
    """Reset time and the states of all entities; spawned entities stay, as in Gazebo."""
    world.reset(ResetScope.TIME | ResetScope.STATE)
    return gazebo_messages.EmptyReport()


def get_model_list(
    world: SimulatedWorld, _: gazebo_messages.GetModelListRequest
) -> gazebo_messages.GetModelListReport:
    """List the names of all entities."""
    return gazebo_messages.GetModelListReport(
        Header(time_from_ns(world.clock.time_ns)),
        tuple(entity.name for entity in world.entities),
        success=True,
    )


def get_gazebo_state(
    world: SimulatedWorld, request: gazebo_messages.GazeboGetEntityStateRequest
) -> gazebo_messages.GazeboGetEntityStateReport:
    """Return pose of an entity or a link in a frame, and twist relative to it."""
    row = find_state(world, request.name)
    frame_id = request.reference_frame
    if frame_id not in WORLD_FRAMES:
        frame = find_state(world, frame_id)
        row = row.copy()
        row[7:] -= frame[7:]
        row = states_to_frame(frame[:7], row[None])[0]
    frame_id = frame_id or "world"
    return gazebo_messages.GazeboGetEntityStateReport(
        Header(time_from_ns(world.clock.time_ns), frame_id),
        gazebo_messages.GazeboEntityState(
            request.name, pose_from_row(row), twist_from_row(row), frame_id
        ),
        success=True,
    )


def set_gazebo_state(
    world: SimulatedWorld, request: gazebo_messages.GazeboSetEntityStateRequest
) -> gazebo_messages.GazeboSetEntityStateReport:
    """Set pose and twist of an entity, by its name or that of its base link."""
    state = request.state
    name, scope, _ = state.name.partition(SCOPE_SEPARATOR)
    if scope and find_link(world, state.name).number:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"link {state.name[:80]!r} is moved by joints and cannot be placed by itself; "
            f"use '{name}'",
        )
    wanted = entity_messages.EntityState(
        Header(frame_id=state.reference_frame), state.pose, state.twist
    )
    set_entity_state(
        world, entity_messages.SetEntityStateRequest(name, wanted, set_pose=True, set_twist=True)
    )
    return gazebo_messages.GazeboSetEntityStateReport(success=True)


def _change_state(
    world: SimulatedWorld, pacing: Pacing, state: State
) -> gazebo_messages.EmptyReport:
    if world.clock.state != state:
        set_simulation_state(world, pacing, SetSimulationStateRequest(SimulationState(state)))
    return gazebo_messages.EmptyReport(Result())
