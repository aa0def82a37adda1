"""Forward kinematics: where the links of entities are. Pure arithmetic on arrays."""

import numpy as np

from zensim.proto.messages.model_messages import Joint, Model, Origin
from zensim.proto.rotation import FloatArray, multiply, rotate

SLIDING = "prismatic"
TURNING = frozenset({"revolute", "continuous"})


def placed(outer: FloatArray, inner: FloatArray) -> FloatArray:
    """Compose poses (..., 7): `inner` is given in the frame that `outer` makes."""
    place = outer[..., :3] + rotate(outer[..., 3:], inner[..., :3])
    return np.concatenate([place, multiply(outer[..., 3:], inner[..., 3:])], axis=-1)


def row_of(origin: Origin) -> FloatArray:
    """Turn a fixed pose into (7,): position, quaternion."""
    return np.array([*origin.position, *origin.orientation])


def joint_motion(joint: Joint, positions: FloatArray) -> FloatArray:
    """Find what positions (n,) [rad or m] do to a joint's child: poses (n, 7) in its frame."""
    motion = np.zeros((len(positions), 7))
    motion[:, 6] = 1.0
    axis = np.array(joint.axis)
    if joint.kind == SLIDING:
        motion[:, :3] = positions[:, None] * axis
    elif joint.kind in TURNING:
        motion[:, 3:6] = np.sin(positions / 2.0)[:, None] * axis
        motion[:, 6] = np.cos(positions / 2.0)
    return motion


def link_poses(model: Model, base: FloatArray, positions: FloatArray) -> dict[str, FloatArray]:
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
        moved = placed(row_of(joint.origin), joint_motion(joint, positions[:, i]))
        poses[joint.child] = placed(poses[joint.parent], moved)
    for frame in model.frames:
        if frame.parent in poses:
            poses.setdefault(frame.name, placed(poses[frame.parent], row_of(frame.origin)))
    return poses
