"""How links move: poses and twists of all links of entities. Pure arithmetic on arrays."""

import numpy as np

from zensim.proto.messages.model_messages import Joint, Model
from zensim.proto.rotation import FloatArray, rotate
from zensim.sim_server.geometry.kinematics import SLIDING, TURNING, link_poses


def link_states(
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
    poses = link_poses(model, base[:, :7], positions)
    twists = {model.links[0].name: base[:, 7:]}
    for i, joint in enumerate(model.joints):
        twists[joint.child] = _carried(
            twists[joint.parent], poses[joint.parent], poses[joint.child]
        ) + _own(joint, poses[joint.child], velocities[:, i])
    for frame in model.frames:
        if frame.parent in twists:
            carried = _carried(twists[frame.parent], poses[frame.parent], poses[frame.name])
            twists.setdefault(frame.name, carried)
    return {name: np.concatenate([poses[name], twist], axis=1) for name, twist in twists.items()}


def _carried(twist: FloatArray, pose: FloatArray, inner: FloatArray) -> FloatArray:
    """Find the twist (n, 6) at `inner` of what moves with a twist at `pose`."""
    linear = twist[:, :3] + np.cross(twist[:, 3:], inner[:, :3] - pose[:, :3])
    return np.concatenate([linear, twist[:, 3:]], axis=1)


def _own(joint: Joint, pose: FloatArray, velocities: FloatArray) -> FloatArray:
    """Find the twist (n, 6) that a joint gives its child, in the world."""
    moving = np.zeros((len(pose), 6))
    axis = rotate(pose[:, 3:], np.broadcast_to(np.array(joint.axis), (len(pose), 3)))
    if joint.kind == SLIDING:
        moving[:, :3] = axis * velocities[:, None]
    elif joint.kind in TURNING:
        moving[:, 3:] = axis * velocities[:, None]
    return moving
