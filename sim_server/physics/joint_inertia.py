"""How easily each joint of a body yields to an effort, by the composite rigid body algorithm."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from zensim.proto.messages.model_messages import Joint, Origin
from zensim.proto.rigid_transforms import compose
from zensim.proto.se3 import FloatArray, rotate
from zensim.sim_server.physics.blueprint import RigidPart
from zensim.sim_server.physics.engine import MIN_INERTIA, MIN_MASS_KG

FREE_ROOT_ROWS = 6


def find_joint_mobilities(parts: Sequence[RigidPart], *, is_static: bool) -> dict[str, float]:
    """Find the acceleration of each moving joint per unit of its effort, joints at zero.

    It is the diagonal of the inverse of the mass matrix: all other joints, and a root that is not
    static, move freely. Reflected inertia of driven wheels counts. Source: Featherstone, "Rigid
    Body Dynamics Algorithms", 2008, chapter 6.

    Args:
        parts: Of a blueprint; parents precede children.
        is_static: Whether the root is fixed.

    Returns:
        By name of the joint [1/(kg m^2) or 1/kg].
    """
    mass = make_mass_matrix(parts)
    if not mass.rows:
        return {}
    inverse = mass.invert(is_static=is_static)
    found = {i: float(inverse[row, row]) for i, row in mass.rows.items()}
    return {
        joint.name: max(0.0, found[i]) for i in mass.rows if (joint := parts[i].joint) is not None
    }


class MassMatrix(NamedTuple):
    """Mass matrix of a body with its joints at zero.

    Attributes:
        matrix: (6 + k, 6 + k): six rows of the root, angular and linear, then one for each joint.
        rows: Row of the joint of each part that moves.
        axes: Twist (6,) of its unit speed, at the root's origin: angular, linear.
    """

    matrix: FloatArray
    rows: dict[int, int]
    axes: dict[int, FloatArray]

    def invert(self, *, is_static: bool) -> FloatArray:
        """Find the inverse; the rows of a static root are 0."""
        free = slice(FREE_ROOT_ROWS if is_static else 0, None)
        own = self.matrix[free, free]
        # Rows of unit diagonal: moments of a wheel and masses differ by many powers of ten.
        scale = 1.0 / np.sqrt(np.diag(own))
        inverse = np.zeros_like(self.matrix)
        inverse[free, free] = np.linalg.pinv(own * np.outer(scale, scale), hermitian=True)
        inverse[free, free] *= np.outer(scale, scale)
        return inverse


def make_mass_matrix(parts: Sequence[RigidPart]) -> MassMatrix:
    """Make the mass matrix of a body; parents precede children."""
    poses = find_part_poses(parts)
    composite = np.array([_make_spatial_inertia(*pair) for pair in zip(parts, poses, strict=True)])
    for i in range(len(parts) - 1, 0, -1):
        composite[parts[i].parent] += composite[i]
    moving = [i for i, part in enumerate(parts) if part.joint and part.joint.kind != "fixed"]
    rows = {i: FREE_ROOT_ROWS + row for row, i in enumerate(moving)}
    axes = {i: _find_joint_axis(parts[i].joint, poses[i]) for i in moving}
    matrix = np.zeros((FREE_ROOT_ROWS + len(moving),) * 2)
    matrix[:FREE_ROOT_ROWS, :FREE_ROOT_ROWS] = composite[0]
    for i in moving:
        force = composite[i] @ axes[i]
        matrix[:FREE_ROOT_ROWS, rows[i]] = matrix[rows[i], :FREE_ROOT_ROWS] = force
        at = i
        while at > 0:
            if at in rows:
                matrix[rows[at], rows[i]] = matrix[rows[i], rows[at]] = axes[at] @ force
            at = parts[at].parent
    return MassMatrix(matrix, rows, axes)


def find_part_poses(parts: Sequence[RigidPart]) -> list[Origin]:
    """Find the pose of each part in the root, joints at zero."""
    poses = [Origin()]
    for part in parts[1:]:
        poses.append(compose(poses[part.parent], part.origin))
    return poses


def _find_joint_axis(joint: Joint | None, pose: Origin) -> FloatArray:
    """Find the twist (6,) of a joint's unit speed at the root's origin: angular, linear."""
    assert joint is not None
    axis = rotate(np.array(pose.orientation), np.array(joint.axis))
    axis = axis / np.linalg.norm(axis)
    if joint.kind == "prismatic":
        return np.concatenate([np.zeros(3), axis])
    return np.concatenate([axis, np.cross(np.array(pose.position), axis)])


def _make_spatial_inertia(part: RigidPart, pose: Origin) -> FloatArray:
    """Make the inertia (6, 6) of a part about the root's origin: angular, linear."""
    if part.joint is None and part.parent >= 0:
        return np.zeros((6, 6))  # further surfaces of a link
    mass = max(part.mass_kg, MIN_MASS_KG)
    placed = compose(pose, Origin(part.com, part.principal))
    axes = rotate(np.array(placed.orientation), np.eye(3))
    moments = axes.T @ np.diag(np.maximum(part.inertia, MIN_INERTIA)) @ axes
    if part.joint is not None and part.reflected_inertia > 0.0:
        moments = _with_reflected_inertia(moments, part, pose)
    x, y, z = placed.position
    arm = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.block([[moments + mass * arm @ arm.T, mass * arm], [mass * arm.T, mass * np.eye(3)]])


def _with_reflected_inertia(moments: FloatArray, part: RigidPart, pose: Origin) -> FloatArray:
    axis = _find_joint_axis(part.joint, Origin((0.0, 0.0, 0.0), pose.orientation))[:3]
    missing = max(0.0, part.reflected_inertia - float(axis @ moments @ axis))
    return np.asarray(moments + missing * np.outer(axis, axis))
