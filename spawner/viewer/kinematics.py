"""Link poses from base poses and joint positions, all entities of a form at once. NumPy only."""

from collections.abc import Sequence
from typing import Final

import msgspec
import numpy as np
from numpy.typing import NDArray

from zensim.proto.messages.model_messages import JointKind, Origin, Quat, Vec3
from zensim.proto.rotation import multiply, rotate

Array = NDArray[np.float64]

TURNING: Final = frozenset({"revolute", "continuous"})
SLIDING: Final = frozenset({"prismatic"})


class Hinge(msgspec.Struct, frozen=True):
    """How one link moves in another; the axis is in the child's frame."""

    kind: JointKind
    parent: int
    """Index of a link that comes before the child."""
    origin: Origin
    axis: Vec3


class Poses(msgspec.Struct, frozen=True, eq=False):
    """Where one link of k entities is, in the world frame."""

    positions: Array
    """(k, 3) [m]."""
    quaternions: Array
    """(k, 4), x y z w."""

    @property
    def wxyzs(self) -> Array:
        """The quaternions as (k, 4), w x y z."""
        return self.quaternions[:, [3, 0, 1, 2]]


def link_poses(hinges: Sequence[Hinge], base: Array, joint_positions: Array) -> list[Poses]:
    """Find the pose of every link of k entities: the base, then what each hinge moves.

    Args:
        hinges: Parents before children.
        base: (k, 7), position and quaternion x y z w of the base in the world frame.
        joint_positions: (k, hinges) [rad or m].
    """
    placed = [Poses(base[:, :3], base[:, 3:7])]
    for hinge, moved in zip(hinges, joint_positions.T, strict=True):
        placed.append(_child_poses(placed[hinge.parent], hinge, moved))
    return placed


def _child_poses(parent: Poses, hinge: Hinge, moved: Array) -> Poses:
    offset, turn = _hinge_motion(hinge, moved)
    origin_position, origin_turn = _arrays(hinge.origin)
    in_parent = origin_position + rotate(origin_turn, offset)
    return Poses(
        parent.positions + rotate(parent.quaternions, in_parent),
        multiply(parent.quaternions, multiply(origin_turn, turn)),
    )


def _hinge_motion(hinge: Hinge, moved: Array) -> tuple[Array, Array]:
    """Translation (k, 3) and rotation (k, 4) of the child in the joint's frame."""
    offset, turn = np.zeros((len(moved), 3)), np.tile((0.0, 0.0, 0.0, 1.0), (len(moved), 1))
    axis = unit(hinge.axis)
    if hinge.kind in SLIDING:
        offset = moved[:, None] * axis
    if hinge.kind in TURNING:
        half = moved[:, None] / 2.0
        turn = np.concatenate((np.sin(half) * axis, np.cos(half)), axis=1)
    return offset, turn


def unit(vector: Vec3 | Quat) -> Array:
    """Scale to length one; what has no length stays as it is."""
    array = np.asarray(vector, dtype=np.float64)
    length = float(np.linalg.norm(array))
    return array / length if length > 0.0 else array


def _arrays(origin: Origin) -> tuple[Array, Array]:
    return np.asarray(origin.position, dtype=np.float64), unit(origin.orientation)
