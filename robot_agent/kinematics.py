"""Where a link of a robot is and how it moves, from its root link and its joints."""

import msgspec

from zensim.proto.messages.model_messages import IDENTITY, ZERO, Joint, Model, Origin, Quat, Vec3
from zensim.robot_agent.reading import Reading
from zensim.robot_agent.transforms import add, compose, cross, multiply, rotate, turn, unit


class LinkMotion(msgspec.Struct, frozen=True, gc=False):
    """Pose and velocities of a link, all in the world."""

    position: Vec3 = ZERO
    orientation: Quat = IDENTITY
    linear: Vec3 = ZERO
    angular: Vec3 = ZERO


class Chain:
    """The joints and fixed places between the root link and another."""

    def __init__(self, model: Model, link: str) -> None:
        """Find the way.

        Args:
            model: Of the robot.
            link: One of its links, or of those merged into one; another name means the root link.
        """
        moving = {joint.child: (index, joint) for index, joint in enumerate(model.joints)}
        places = {frame.name: frame for frame in model.frames}
        self._fixed = Origin()
        if link in places:
            self._fixed, link = places[link].origin, places[link].parent
        self._joints: list[tuple[int, Joint, Vec3]] = []
        while link in moving:
            index, joint = moving[link]
            self._joints.insert(0, (index, joint, unit(joint.axis)))
            link = joint.parent

    def motion(self, reading: Reading) -> LinkMotion:
        """Find the motion of the link."""
        px, py, pz, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz = reading.base
        at = LinkMotion((px, py, pz), (qx, qy, qz, qw), (vx, vy, vz), (wx, wy, wz))
        for index, joint, axis in self._joints:
            at = _carried(at, joint.origin)
            at = _moved(at, joint, axis, reading.positions[index], reading.velocities[index])
        return _carried(at, self._fixed)


def _carried(at: LinkMotion, origin: Origin) -> LinkMotion:
    arm = rotate(at.orientation, origin.position)
    return LinkMotion(
        add(at.position, arm),
        multiply(at.orientation, origin.orientation),
        add(at.linear, cross(at.angular, arm)),
        at.angular,
    )


def _moved(
    at: LinkMotion, joint: Joint, axis: Vec3, position: float, velocity: float
) -> LinkMotion:
    along = rotate(at.orientation, axis)
    if joint.kind == "prismatic":
        slid = _carried(at, Origin(scaled(axis, position)))
        return msgspec.structs.replace(slid, linear=add(slid.linear, scaled(along, velocity)))
    if joint.kind == "fixed":
        return at
    turned = compose(Origin(ZERO, at.orientation), Origin(ZERO, turn(axis, position)))
    return msgspec.structs.replace(
        at,
        orientation=turned.orientation,
        angular=add(at.angular, scaled(along, velocity)),
    )


def scaled(vector: Vec3, factor: float) -> Vec3:
    """Make a vector longer or shorter."""
    return (vector[0] * factor, vector[1] * factor, vector[2] * factor)
