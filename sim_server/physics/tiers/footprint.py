"""How much room a model takes on the ground: a disc, and how low and how high it is."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zensim.proto.messages.model_messages import Model, Origin, Shape
from zensim.proto.rotation import rotate
from zensim.proto.stl import read_corners
from zensim.sim_server.description.model_geometry import (
    compose_poses,
    find_link_poses,
    links_in_contact,
)
from zensim.sim_server.physics.engine import FloatArray

Corners = Callable[[str], FloatArray]
"""Corners (3 f, 3) of the triangles of the mesh of a `Shape.mesh`, unscaled."""
CUBE = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
RING = 16
"""Corners of the polygon about a circle."""
FOOT_M = 0.01
"""What reaches this near to the lowest point stands on the ground."""


@dataclass(frozen=True)
class Piece:
    """One collision: the hull of points (m, 3), thickened by a ball [m]."""

    points: FloatArray
    ball_m: float

    @property
    def low(self) -> float:
        """Its lowest height."""
        return float(self.points[:, 2].min()) - self.ball_m

    @property
    def high(self) -> float:
        """Its greatest height."""
        return float(self.points[:, 2].max()) + self.ball_m


@dataclass(frozen=True)
class Footprint:
    """A disc about a point of the root link, and heights against it, joints at zero [m].

    Attributes:
        feet: (m, 2) where it stands on the ground.
    """

    centre: tuple[float, float]
    radius_m: float
    low: float
    high: float
    feet: FloatArray


def ring(radius_m: float, corners: int = RING) -> FloatArray:
    """Find the corners (k, 2) of a polygon that a circle about the origin fits into."""
    turns = np.arange(corners) * (2.0 * math.pi / corners)
    reach = radius_m / math.cos(math.pi / corners)
    return np.stack([np.cos(turns), np.sin(turns)], axis=1) * reach


def corners_in(folder: str) -> Corners:
    """Find meshes in a folder."""

    def corners(mesh: str) -> FloatArray:
        return read_corners(Path(folder, f"{mesh}.stl").read_bytes()).astype(np.float64)

    return corners


def piece_of(shape: Shape, pose: Origin, corners: Corners) -> Piece:
    """Lay out a collision that is not a plane.

    Args:
        shape: The collision.
        pose: Of the frame that `Shape.origin` is in.
        corners: Finds those of a mesh.
    """
    points, ball_m = _points(shape, corners)
    place = compose_poses(pose, shape.origin)
    turned = rotate(np.array(place.orientation), points)
    return Piece(turned + np.array(place.position), ball_m)


def pieces_of(model: Model, corners: Corners) -> Iterator[Piece]:
    """Lay out the collisions of a model in its root link, joints at zero; planes are left out."""
    poses = find_link_poses(model.links[0].name, model.joints)
    for link in links_in_contact(model):
        for shape in link.collisions:
            if shape.kind != "plane":
                yield piece_of(shape, poses[link.name], corners)


def footprint_of(
    model: Model, corners: Corners, pivot: tuple[float, float] | None = None
) -> Footprint:
    """Find the room that a model takes which keeps its joints and only turns about z.

    Args:
        model: Of what stands upright.
        corners: Finds those of a mesh.
        pivot: What the disc is about; None = the middle of all collisions.
    """
    pieces = list(pieces_of(model, corners)) or [Piece(np.zeros((1, 3)), 0.0)]
    low = min(piece.low for piece in pieces)
    if pivot is None:
        least = np.min([p.points[:, :2].min(axis=0) - p.ball_m for p in pieces], axis=0)
        most = np.max([p.points[:, :2].max(axis=0) + p.ball_m for p in pieces], axis=0)
        x, y = ((least + most) / 2.0).tolist()
        pivot = (x, y)
    radius = max(_reach(piece, np.array(pivot)) for piece in pieces)
    feet = [_foot(piece) for piece in pieces if piece.low <= low + FOOT_M]
    high = max(piece.high for piece in pieces)
    return Footprint(pivot, radius, low, high, np.concatenate(feet))


def reach_of(model: Model, corners: Corners) -> float:
    """Find how far [m] a model may reach from its root, however its joints stand."""
    links = {model.links[0].name: 0.0}
    for joint in model.joints:
        slide = max(abs(joint.lower), abs(joint.upper)) if joint.kind == "prismatic" else 0.0
        links[joint.child] = links[joint.parent] + math.hypot(*joint.origin.position) + slide
    return max(
        (
            links[link.name] + _distance(piece_of(shape, Origin(), corners))
            for link in model.links
            for shape in link.collisions
            if shape.kind != "plane"
        ),
        default=0.0,
    )


def _reach(piece: Piece, pivot: FloatArray) -> float:
    arms = piece.points[:, :2] - pivot
    return float(np.hypot(arms[:, 0], arms[:, 1]).max()) + piece.ball_m


def _distance(piece: Piece) -> float:
    return float(np.linalg.norm(piece.points, axis=1).max()) + piece.ball_m


def _foot(piece: Piece) -> FloatArray:
    lowest = piece.points[:, 2] <= piece.points[:, 2].min() + FOOT_M
    return piece.points[lowest, :2]


def _points(shape: Shape, corners: Corners) -> tuple[FloatArray, float]:
    first, second, _ = shape.size
    if shape.kind == "box":
        return CUBE * np.array(shape.size), 0.0
    if shape.kind == "sphere":
        return np.zeros((1, 3)), first
    ends = np.array([[0.0, 0.0, -second / 2.0], [0.0, 0.0, second / 2.0]])
    if shape.kind == "capsule":
        return ends, first
    if shape.kind == "cylinder":
        rim = np.concatenate([ring(first), np.zeros((RING, 1))], axis=1)
        return (ends[:, None, :] + rim).reshape(-1, 3), 0.0
    return corners(shape.mesh) * np.array(shape.size), 0.0
