"""Boxes around models: with joints at zero, and as they are. NumPy only."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from zensim.proto.messages.model_messages import MOVABLE_KINDS
from zensim.proto.se3 import FloatArray, compose, from_origin, invert, transform_points
from zensim.spawner.page.model_visuals import (
    Array,
    ColouredMesh,
    VisualJoint,
    VisualTemplate,
    find_link_poses,
)


@dataclass(frozen=True, eq=False)
class ModelBounds:
    """Box around a model in the frame of its base.

    Attributes:
        at_rest: Lowest and highest corner (2, 3) with joints at zero.
        joints: Of the model; empty if its box is always the same.
        links: Lowest and highest corners (links, 2, 3) of links in their frames, NaN without mesh.
    """

    at_rest: Array
    joints: tuple[VisualJoint, ...] = ()
    links: Array | None = None

    def find(self, find_poses: Callable[[], FloatArray]) -> Array:
        """Find the lowest and highest corner (2, 3) of an entity.

        Args:
            find_poses: Finds the poses (links, 7) of its links; called if they matter.
        """
        if self.links is None:
            return self.at_rest
        placed = np.array(find_poses())
        for number in find_wheels(self.joints):
            # As if it had not turned: the corners of its box would shake.
            joint = self.joints[number - 1]
            placed[number] = compose(placed[joint.parent], from_origin(joint.origin))
        is_drawn = ~np.isnan(self.links[:, 0, 0])
        sides = [self.links[is_drawn][:, side, (0, 1, 2)] for side in product((0, 1), repeat=3)]
        corners = transform_points(placed[is_drawn], np.stack(sides)).reshape(-1, 3)
        return _find_span(transform_points(invert(placed[0]), corners))


def make_bounds(template: VisualTemplate, parts: Sequence[Sequence[ColouredMesh]]) -> ModelBounds:
    """Make the bounds of a template from the meshes of each of its links; 0 without meshes."""
    base = np.array([(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)])
    joints = template.visual_joints
    vertices = [[part.mesh.vertices for part in meshes] for meshes in parts]
    if not any(vertices):
        return ModelBounds(np.zeros((2, 3)))
    poses = find_link_poses(joints, base, np.zeros((1, len(joints))))
    placed = [
        transform_points(pose, own)
        for pose, link in zip(poses, vertices, strict=True)
        for own in link
    ]
    at_rest = _find_span(np.concatenate(placed))
    moving = sum(joint.kind in MOVABLE_KINDS for joint in joints)
    if moving == len(find_wheels(joints)):
        return ModelBounds(at_rest)
    nothing = np.full((2, 3), np.nan)
    links = [_find_span(np.concatenate(link)) if link else nothing for link in vertices]
    return ModelBounds(at_rest, joints, np.stack(links))


def find_wheels(joints: Sequence[VisualJoint]) -> list[int]:
    """List the links that turn without end and carry nothing, which stay within one box."""
    parents = {joint.parent for joint in joints}
    return [
        number
        for number, joint in enumerate(joints, start=1)
        if joint.kind == "continuous" and number not in parents
    ]


def _find_span(points: Array) -> Array:
    return np.stack([points.min(axis=0), points.max(axis=0)])
