"""Gazebo's properties of joints and links: told, and changed while the world runs.

A change makes the body anew of another model: what the engine has is always what the model says.
"""

import math

import msgspec
import numpy as np

from zensim.proto.messages import gazebo_messages
from zensim.proto.messages.gazebo_messages import JointType
from zensim.proto.messages.model_messages import Inertial, Joint, Link
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import Point, Pose, Quaternion
from zensim.proto.rotation import conjugate, rotate
from zensim.sim_server.desk import Desk
from zensim.sim_server.errors import Refused
from zensim.sim_server.lookup.scoped import ScopedJoint, ScopedLink, joint_of, link_of
from zensim.sim_server.world.poses import pose_row

TYPES = {
    "revolute": JointType.REVOLUTE,
    "continuous": JointType.CONTINUOUS,
    "prismatic": JointType.PRISMATIC,
    "fixed": JointType.FIXED,
}
LIMITED = ("revolute", "prismatic")
OF_ODE = ("erp", "cfm", "stop_erp", "stop_cfm", "fudge_factor", "vel")
"""Settings of a solver that is not here."""
MOST = 1e6


def get_joint_properties(
    desk: Desk, request: gazebo_messages.GetJointPropertiesRequest
) -> gazebo_messages.GetJointPropertiesReport:
    """Tell how a joint moves, and where it is."""
    target = joint_of(desk.world, request.joint_name)
    joint = target.joint
    if joint.kind == "fixed":
        return gazebo_messages.GetJointPropertiesReport(type=JointType.FIXED, success=True)
    reading = desk.world.reading()
    place = desk.world.roster().joints_of(target.entity.name).start + target.number
    is_limited = joint.kind in LIMITED
    return gazebo_messages.GetJointPropertiesReport(
        type=TYPES[joint.kind],
        damping=(joint.damping,),
        position=(float(reading.joint_positions[place]),),
        rate=(float(reading.joint_velocities[place]),),
        success=True,
        lower=(joint.lower,) if is_limited else (),
        upper=(joint.upper,) if is_limited else (),
        friction=(joint.friction,),
    )


def set_joint_properties(
    desk: Desk, request: gazebo_messages.SetJointPropertiesRequest
) -> gazebo_messages.SetJointPropertiesReport:
    """Change damping, friction and limits of a joint."""
    target = joint_of(desk.world, request.joint_name)
    _change_joint(desk, target, _changed(target.joint, request))
    return gazebo_messages.SetJointPropertiesReport(success=True)


def get_link_properties(
    desk: Desk, request: gazebo_messages.GetLinkPropertiesRequest
) -> gazebo_messages.GetLinkPropertiesReport:
    """Tell what a link weighs; the moments are about the link's own axes."""
    link = link_of(desk.world, request.link_name).link
    return gazebo_messages.GetLinkPropertiesReport(
        Pose(Point(*link.inertial.com_in_link), Quaternion()),
        link.weightless == Inertial(),
        link.inertial.mass_kg,
        *link.inertial.inertia,
        success=True,
    )


def set_link_properties(
    desk: Desk, request: gazebo_messages.SetLinkPropertiesRequest
) -> gazebo_messages.SetLinkPropertiesReport:
    """Change what a link weighs, and whether gravity pulls it."""
    target = link_of(desk.world, request.link_name)
    if target.entity.model.is_static and target.number == 0:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"link {request.link_name[:80]!r} never moves: its model is static; nothing to weigh",
        )
    inertial = _inertial(request)
    weightless = Inertial() if request.gravity_mode else inertial
    _change_link(
        desk,
        target,
        msgspec.structs.replace(target.link, inertial=inertial, weightless=weightless),
    )
    return gazebo_messages.SetLinkPropertiesReport(success=True)


def _change_joint(desk: Desk, target: ScopedJoint, joint: Joint) -> None:
    joints = list(target.entity.model.joints)
    joints[target.number] = joint
    model = msgspec.structs.replace(target.entity.model, joints=tuple(joints))
    if model != target.entity.model:
        desk.world.remodel(target.entity.name, model)


def _change_link(desk: Desk, target: ScopedLink, link: Link) -> None:
    links = list(target.entity.model.links)
    links[target.number] = link
    model = msgspec.structs.replace(target.entity.model, links=tuple(links))
    if model != target.entity.model:
        desk.world.remodel(target.entity.name, model)


def _changed(joint: Joint, request: gazebo_messages.SetJointPropertiesRequest) -> Joint:
    wanted, name = request.ode_joint_config, request.joint_name[:80]
    for field in OF_ODE:
        if getattr(wanted, field):
            raise Refused(
                ResultCode.FEATURE_UNSUPPORTED,
                f"{field} of joint {name!r} is of ODE's solver; set damping, fmax, lo_stop, "
                "hi_stop and leave the others empty",
            )
    if joint.kind == "fixed" and wanted != gazebo_messages.ODEJointProperties():
        raise Refused(ResultCode.OPERATION_FAILED, f"joint {name!r} is fixed; nothing can be set")
    lower, upper = _one(wanted.lo_stop, "lo_stop"), _one(wanted.hi_stop, "hi_stop")
    damping, friction = _one(wanted.damping, "damping"), _one(wanted.fmax, "fmax")
    for what, number in (("damping", damping), ("fmax", friction)):
        if number is not None and number < 0.0:
            raise Refused(ResultCode.OPERATION_FAILED, f"{what} {number:g} is negative; use 0")
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
    if joint.kind not in LIMITED:
        raise Refused(
            ResultCode.FEATURE_UNSUPPORTED,
            f"joint {name!r} is {joint.kind} and has no limits; make it revolute in its model",
        )
    low = joint.lower if lower is None else lower
    high = joint.upper if upper is None else upper
    if low > high:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"lo_stop {low:g} of joint {name!r} is above hi_stop {high:g}; set both",
        )


def _one(numbers: tuple[float, ...], what: str) -> float | None:
    if not numbers:
        return None
    if len(numbers) > 1 or not math.isfinite(numbers[0]) or abs(numbers[0]) > MOST:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"{what} has {len(numbers)} numbers, the first {numbers[0]:g}; "
            f"use one finite number, {MOST:g} at most: each joint here has one axis",
        )
    return numbers[0]


def _inertial(request: gazebo_messages.SetLinkPropertiesRequest) -> Inertial:
    moments = (request.ixx, request.ixy, request.ixz, request.iyy, request.iyz, request.izz)
    numbers = (request.mass, *moments)
    if not all(math.isfinite(number) and abs(number) <= MOST for number in numbers):
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"mass or a moment is out of range; use finite numbers, {MOST:g} at most",
        )
    if request.mass <= 0.0:
        raise Refused(
            ResultCode.OPERATION_FAILED,
            f"mass {request.mass:g} is not positive; every field counts: get them, then set them",
        )
    com = pose_row(request.com)
    ixx, ixy, ixz, iyy, iyz, izz = moments
    matrix = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
    if float(np.linalg.eigvalsh(matrix).min()) < 0.0:
        raise Refused(
            ResultCode.OPERATION_FAILED, "a moment of inertia is negative; use what a body can have"
        )
    # The moments are given about the axes of `com`; those of a model are about the link's.
    axes = rotate(conjugate(com[3:]), np.eye(3))
    turned = axes @ matrix @ axes.T
    x, y, z = com[:3].tolist()
    (xx, xy, xz), (_, yy, yz), (_, _, zz) = turned.tolist()
    return Inertial(request.mass, (x, y, z), (xx, xy, xz, yy, yz, zz))
