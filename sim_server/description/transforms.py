"""Fixed poses put one after another."""

import numpy as np

from zensim.proto.messages.model_messages import IDENTITY, Joint, Origin, Vec3
from zensim.proto.rotation import FloatArray, multiply, rotate


def compose(outer: Origin, inner: Origin) -> Origin:
    """Find the pose in the frame of `outer` of what `inner` places in the frame that it makes."""
    if outer == Origin():
        return inner
    x, y, z = placed(outer, inner.position)
    if outer.orientation == IDENTITY:
        return Origin((x, y, z), inner.orientation)
    turn = multiply(np.array(outer.orientation), np.array(inner.orientation))
    qx, qy, qz, qw = (turn / np.linalg.norm(turn)).tolist()
    return Origin((x, y, z), (qx, qy, qz, qw))


def placed(origin: Origin, point: Vec3) -> Vec3:
    """Find a point of a frame in the frame that `origin` is given in."""
    ox, oy, oz = origin.position
    x, y, z = turned(origin, point)
    return (ox + x, oy + y, oz + z)


def turned(origin: Origin, vector: Vec3) -> Vec3:
    """Find a direction of a frame in the frame that `origin` is given in."""
    if origin.orientation == IDENTITY:
        return vector
    x, y, z = rotate(np.array(origin.orientation), np.array(vector)).tolist()
    return (x, y, z)


def matrix_of(origin: Origin) -> FloatArray:
    """Find the rotation matrix (3, 3) of a pose."""
    columns = rotate(np.array(origin.orientation), np.eye(3))
    return np.asarray(columns.T)


def link_poses(root: str, joints: tuple[Joint, ...]) -> dict[str, Origin]:
    """Find every link's pose in the root link, all joints at zero; parents come before children."""
    poses = {root: Origin()}
    for joint in joints:
        poses[joint.child] = compose(poses[joint.parent], joint.origin)
    return poses
