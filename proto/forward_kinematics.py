"""Forward kinematics on arrays: poses and twists of all links of many entities of one model."""

from collections.abc import Iterable
from typing import Protocol

import numpy as np

from zensim.proto.messages.model_messages import Joint, JointKind, Model, Origin, Vec3
from zensim.proto.se3 import (
    IDENTITY_POSE,
    FloatArray,
    compose,
    cross,
    from_axis_angle,
    from_origin,
    rotate,
)

PRISMATIC = "prismatic"
ROTATIONAL = frozenset({"revolute", "continuous"})


class JointGeometry(Protocol):
    """How a joint moves its child in its parent."""

    @property
    def kind(self) -> JointKind:
        """Which motion it allows."""

    @property
    def origin(self) -> Origin:
        """Pose of the child in the parent at position 0."""

    @property
    def axis(self) -> Vec3:
        """Unit vector in the child's frame."""


def compute_joint_poses(joint: JointGeometry, positions: FloatArray) -> FloatArray:
    """Find poses (n, 7) of a joint's child in the parent at positions (n,) [rad or m]."""
    motion = np.tile(IDENTITY_POSE, (len(positions), 1))
    axis = np.array(joint.axis)
    if joint.kind == PRISMATIC:
        motion[:, :3] = positions[:, None] * axis
    elif joint.kind in ROTATIONAL:
        motion[:, 3:] = from_axis_angle(axis, positions)
    return compose(from_origin(joint.origin), motion)


def compute_chain_poses(
    joints: Iterable[tuple[int, JointGeometry]], base: FloatArray, positions: FloatArray
) -> list[FloatArray]:
    """Find the poses of the root link and of each joint's child.

    Args:
        joints: Index of the parent link and joint; `joints[i]` moves link `i + 1`.
        base: Poses (n, 7) of the root links in the world.
        positions: (n, k) of the joints [rad or m].

    Returns:
        Poses (n, 7) in the world, by link.
    """
    poses = [base]
    for (parent, joint), moved in zip(joints, positions.T, strict=True):
        poses.append(compose(poses[parent], compute_joint_poses(joint, moved)))
    return poses


def compute_link_poses(
    model: Model, base: FloatArray, positions: FloatArray
) -> dict[str, FloatArray]:
    """Find the poses of all links and of the frames that were merged into them.

    Args:
        model: Common to all n entities.
        base: Poses (n, 7) of their root links in the world.
        positions: (n, k) of their joints, in the order of `Model.joints`.

    Returns:
        Poses (n, 7) in the world, by name.
    """
    index = {link.name: number for number, link in enumerate(model.links)}
    joints = ((index[joint.parent], joint) for joint in model.joints)
    poses = dict(zip(index, compute_chain_poses(joints, base, positions), strict=True))
    for frame in model.frames:
        if frame.parent in poses:
            poses.setdefault(frame.name, compose(poses[frame.parent], from_origin(frame.origin)))
    return poses


def compute_link_states(
    model: Model, base: FloatArray, positions: FloatArray, velocities: FloatArray
) -> dict[str, FloatArray]:
    """Find the states of all links and of the frames that were merged into them.

    Args:
        model: Common to all n entities.
        base: State rows (n, 13) of their root links in the world.
        positions: (n, k) of their joints, in the order of `Model.joints`.
        velocities: (n, k) likewise.

    Returns:
        State rows (n, 13) in the world, by name.
    """
    poses = compute_link_poses(model, base[:, :7], positions)
    twists = {model.links[0].name: base[:, 7:]}
    for i, joint in enumerate(model.joints):
        twists[joint.child] = _transfer_twist(
            twists[joint.parent], poses[joint.parent], poses[joint.child]
        ) + _joint_twist(joint, poses[joint.child], velocities[:, i])
    for frame in model.frames:
        if frame.parent in twists:
            carried = _transfer_twist(twists[frame.parent], poses[frame.parent], poses[frame.name])
            twists.setdefault(frame.name, carried)
    return {name: np.concatenate([poses[name], twist], axis=1) for name, twist in twists.items()}


def _transfer_twist(twist: FloatArray, pose: FloatArray, inner: FloatArray) -> FloatArray:
    """Find the twists (n, 6) at `inner` of rigid bodies with these twists at `pose`."""
    linear = twist[:, :3] + cross(twist[:, 3:], inner[:, :3] - pose[:, :3])
    return np.concatenate([linear, twist[:, 3:]], axis=1)


def _joint_twist(joint: Joint, pose: FloatArray, velocities: FloatArray) -> FloatArray:
    """Find the twists (n, 6), along the world's axes, that a joint adds to its child."""
    moving = np.zeros((len(pose), 6))
    axis = rotate(pose[:, 3:], np.broadcast_to(np.array(joint.axis), (len(pose), 3)))
    if joint.kind == PRISMATIC:
        moving[:, :3] = axis * velocities[:, None]
    elif joint.kind in ROTATIONAL:
        moving[:, 3:] = axis * velocities[:, None]
    return moving
