"""Pose and velocities of a link by the joints between it and the root link, in columns."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Generic

import msgspec

from zensim.proto.drives.column_math import Column, ColumnMath
from zensim.proto.messages.model_messages import JointKind, Model, Origin, Vec3
from zensim.proto.rigid_transforms import (
    Rotation,
    Vector,
    add,
    compose,
    cross,
    multiply,
    normalize,
    rotate,
    rotate_about,
)


@dataclass(frozen=True)
class LinkState(Generic[Column]):
    """Pose and velocities of a link in the world."""

    position: Vector[Column]
    orientation: Rotation[Column]
    linear: Vector[Column]
    angular: Vector[Column]


class ChainJoint(msgspec.Struct, frozen=True):
    """How a joint moves its child in its parent."""

    index: int
    """Index in `Model.joints`."""
    kind: JointKind
    origin: Origin
    axis: Vec3
    """Unit vector."""


class LinkChain(msgspec.Struct, frozen=True):
    """The joints from the root link to another link, and a pose fixed to that link."""

    joints: tuple[ChainJoint, ...]
    fixed: Origin = Origin()

    def extend(self, origin: Origin) -> "LinkChain":
        """Make the chain to a pose in the frame at the end of this one."""
        return LinkChain(self.joints, compose(self.fixed, origin))

    def motion(
        self,
        base: Sequence[Column],
        positions: Sequence[Column],
        velocities: Sequence[Column],
        xp: ColumnMath[Column],
    ) -> LinkState[Column]:
        """Find the state at the end of the chain.

        Args:
            base: Of the root link, columns as in
                `zensim.proto.messages.agent_messages.STATE_COLUMNS`.
            positions: Of all joints of the model [rad or m].
            velocities: Of all joints [rad/s or m/s].
            xp: Arithmetic of the columns.
        """
        px, py, pz, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz = base
        at = LinkState((px, py, pz), (qx, qy, qz, qw), (vx, vy, vz), (wx, wy, wz))
        for joint in self.joints:
            at = _move_by_origin(at, joint.origin)
            if joint.kind == "prismatic":
                at = _slide(at, joint.axis, positions[joint.index], velocities[joint.index])
            elif joint.kind != "fixed":
                turn = rotate_about(joint.axis, positions[joint.index], xp)
                at = _turn(at, joint.axis, turn, velocities[joint.index])
        return _move_by_origin(at, self.fixed)


def find_link_chain(model: Model, link: str) -> LinkChain:
    """Find the chain to a link, or to a frame fixed to one; an unknown name means the root."""
    moving = {joint.child: (index, joint) for index, joint in enumerate(model.joints)}
    places = {frame.name: frame for frame in model.frames}
    fixed = Origin()
    if link in places:
        fixed, link = places[link].origin, places[link].parent
    joints: list[ChainJoint] = []
    while link in moving:
        index, joint = moving[link]
        joints.insert(0, ChainJoint(index, joint.kind, joint.origin, normalize(joint.axis)))
        link = joint.parent
    return LinkChain(tuple(joints), fixed)


def _move_by_origin(at: LinkState[Column], origin: Origin) -> LinkState[Column]:
    arm = rotate(at.orientation, origin.position)
    return LinkState(
        add(at.position, arm),
        multiply(at.orientation, origin.orientation),
        add(at.linear, cross(at.angular, arm)),
        at.angular,
    )


def _slide(
    at: LinkState[Column], axis: Vec3, position: Column, velocity: Column
) -> LinkState[Column]:
    x, y, z = rotate(at.orientation, axis)
    arm = (x * position, y * position, z * position)
    linear = add(at.linear, cross(at.angular, arm))
    return LinkState(
        add(at.position, arm),
        at.orientation,
        add(linear, (x * velocity, y * velocity, z * velocity)),
        at.angular,
    )


def _turn(
    at: LinkState[Column], axis: Vec3, turn: Rotation[Column], velocity: Column
) -> LinkState[Column]:
    x, y, z = rotate(at.orientation, axis)
    return LinkState(
        at.position,
        multiply(at.orientation, turn),
        at.linear,
        add(at.angular, (x * velocity, y * velocity, z * velocity)),
    )
