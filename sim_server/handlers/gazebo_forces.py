"""Gazebo's wrenches on links and efforts on joints, for a while of simulation time."""

import math

import numpy as np

from zensim.proto.messages import gazebo_messages
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import Duration, Point, Time, Vector3, ns_from_time
from zensim.proto.rotation import FloatArray, rotate
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import Refused
from zensim.sim_server.lookup.frames import frame_pose
from zensim.sim_server.lookup.scoped import ScopedLink, joint_of, link_of, state_of
from zensim.sim_server.world.poses import MAX_POSITION_M, WORLD_FRAMES
from zensim.sim_server.world.pushes import JointPush, LinkPush, Span, span_of
from zensim.sim_server.world.world import World

MOST = 1e6
"""Of a force [N], a torque or an effort [N m]."""


def apply_link_wrench(
    desk: Desk, request: gazebo_messages.ApplyLinkWrenchRequest
) -> gazebo_messages.ApplyLinkWrenchReport:
    """Push a link: the wrench keeps the direction in the world that it has now."""
    target = link_of(desk.world, request.link_name)
    force, torque = _vector(request.wrench.force, "force"), _vector(request.wrench.torque, "torque")
    wrench = _at_mass(desk.world, target, request, force, torque)
    span = _span(desk.world, request.start_time, request.duration)
    if span is None:
        return gazebo_messages.ApplyLinkWrenchReport(
            success=True, status_message="duration 0: nothing done"
        )
    desk.world.pushes.add(LinkPush(target.entity.name, target.number, wrench, span))
    return gazebo_messages.ApplyLinkWrenchReport(success=True, status_message=_said(span))


def clear_link_wrenches(
    desk: Desk, request: gazebo_messages.ClearLinkWrenchesRequest
) -> gazebo_messages.ClearLinkWrenchesReport:
    """Push a link no more; none to clear is fine."""
    target = link_of(desk.world, request.link_name)
    desk.world.pushes.clear_link(target.entity.name, target.number)
    return gazebo_messages.ClearLinkWrenchesReport()


def apply_joint_effort(
    desk: Desk, request: gazebo_messages.ApplyJointEffortRequest
) -> gazebo_messages.ApplyJointEffortReport:
    """Push a joint along its axis."""
    target = joint_of(desk.world, request.joint_name)
    if target.joint.kind == "fixed":
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"joint {request.joint_name[:80]!r} is fixed; name one that moves",
        )
    (effort,) = _checked((request.effort,), "effort")
    span = _span(desk.world, request.start_time, request.duration)
    if span is None:
        return gazebo_messages.ApplyJointEffortReport(
            success=True, status_message="duration 0: nothing done"
        )
    desk.world.pushes.add(JointPush(target.entity.name, target.number, effort, span))
    return gazebo_messages.ApplyJointEffortReport(success=True, status_message=_said(span))


def clear_joint_efforts(
    desk: Desk, request: gazebo_messages.ClearJointEffortsRequest
) -> gazebo_messages.ClearJointEffortsReport:
    """Push a joint no more; none to clear is fine."""
    target = joint_of(desk.world, request.joint_name)
    desk.world.pushes.clear_joint(target.entity.name, target.number)
    return gazebo_messages.ClearJointEffortsReport()


def _at_mass(
    world: World,
    target: ScopedLink,
    request: gazebo_messages.ApplyLinkWrenchRequest,
    force: FloatArray,
    torque: FloatArray,
) -> FloatArray:
    """Turn a wrench at a point of a frame into one (6,) at the centre of mass, world axes."""
    point = _vector(request.reference_point, "reference_point", MAX_POSITION_M)
    if request.reference_frame in WORLD_FRAMES:
        return np.concatenate([force, torque + np.cross(point, force)])
    frame = frame_pose(world, request.reference_frame)
    force, torque = rotate(frame[3:], force), rotate(frame[3:], torque)
    link = state_of(world, f"{target.entity.name}::{target.link.name}")
    mass = link[:3] + rotate(link[3:7], np.array(target.link.inertial.com_in_link))
    arm = frame[:3] + rotate(frame[3:], point) - mass
    return np.concatenate([force, torque + np.cross(arm, force)])


def _span(world: World, start: Time, duration: Duration) -> Span | None:
    return span_of(
        now_ns=world.time_ns,
        start_ns=ns_from_time(start),
        duration_ns=ns_from_time(duration),
        step_ns=world.step_ns,
    )


def _said(span: Span) -> str:
    end = "for ever" if span.end_ns is None else f"to {span.end_ns * 1e-9:.9g} s"
    return f"from {span.start_ns * 1e-9:.9g} s {end} of simulation time"


def _vector(vector: Vector3 | Point, what: str, most: float = MOST) -> FloatArray:
    return np.array(_checked((vector.x, vector.y, vector.z), what, most))


def _checked(numbers: tuple[float, ...], what: str, most: float = MOST) -> tuple[float, ...]:
    for number in numbers:
        if not (math.isfinite(number) and abs(number) <= most):
            raise Refused(
                ResultCode.OPERATION_FAILED,
                f"{what} {number:g} is out of range; use a finite number, {most:g} at most",
            )
    return numbers
