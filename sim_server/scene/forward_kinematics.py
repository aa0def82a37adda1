"""Forward kinematics of models on arrays: poses and twists of all links."""

import numpy as np

from zensim.proto.messages.model_messages import Joint, Model, Origin
from zensim.proto.rotation import FloatArray, multiply, rotate

PRISMATIC = "prismatic"
ROTATIONAL = frozenset({"revolute", "continuous"})


def compose_poses(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Compose poses (..., 7): `inner` is given in the frame that `outer` makes."""
    place = outer[..., :3] + rotate(outer[..., 3:], inner[..., :3])
    return np.concatenate([place, multiply(outer[..., 3:], inner[..., 3:])], axis=-1)


def origin_to_pose(origin: Origin) -> FloatArray:
    """Turn a fixed pose into (7,): position, quaternion."""
    return np.array([*origin.position, *origin.orientation])


def compute_joint_poses(joint: Joint, positions: FloatArray) -> FloatArray:
    """Find what positions (n,) [rad or m] do to a joint's child: poses (n, 7) in its frame."""
    motion = np.zeros((len(positions), 7))
    motion[:, 6] = 1.0
    axis = np.array(joint.axis)
    if joint.kind == PRISMATIC:
        motion[:, :3] = positions[:, None] * axis
    elif joint.kind in ROTATIONAL:
        motion[:, 3:6] = np.sin(positions / 2.0)[:, None] * axis
        motion[:, 6] = np.cos(positions / 2.0)
    return motion


def compute_link_poses(
    model: Model, base: FloatArray, positions: FloatArray
) -> dict[str, FloatArray]:
    """Find where all links are, and the frames that were merged into them.

    Args:
        model: Of all the entities.
        base: Poses (n, 7) of their root links in the world.
        positions: (n, k) of their joints, in the order of `Model.joints`.

    Returns:
        Poses (n, 7) in the world, by name.
    """
    poses = {model.links[0].name: base}
    for i, joint in enumerate(model.joints):
        moved = compose_poses(
            origin_to_pose(joint.origin), compute_joint_poses(joint, positions[:, i])
        )
        poses[joint.child] = compose_poses(poses[joint.parent], moved)
    for frame in model.frames:
        if frame.parent in poses:
            poses.setdefault(
                frame.name, compose_poses(poses[frame.parent], origin_to_pose(frame.origin))
            )
    return poses


def compute_link_states(
    model: Model, base: FloatArray, positions: FloatArray, velocities: FloatArray
) -> dict[str, FloatArray]:
    """Find where all links are and how they move, and the frames that were merged into them.

    Args:
        model: Of all the entities.
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
    """Find the twist (n, 6) at `inner` of what moves with a twist at `pose`."""
    linear = twist[:, :3] + np.cross(twist[:, 3:], inner[:, :3] - pose[:, :3])
    return np.concatenate([linear, twist[:, 3:]], axis=1)


def _joint_twist(joint: Joint, pose: FloatArray, velocities: FloatArray) -> FloatArray:
    """Find the twist (n, 6) that a joint gives its child, in the world."""
    moving = np.zeros((len(pose), 6))
    axis = rotate(pose[:, 3:], np.broadcast_to(np.array(joint.axis), (len(pose), 3)))
    if joint.kind == PRISMATIC:
        moving[:, :3] = axis * velocities[:, None]
    elif joint.kind in ROTATIONAL:
        moving[:, 3:] = axis * velocities[:, None]
    return moving
