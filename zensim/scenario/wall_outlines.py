"""Outlines of a world's own entities, as rectangles on the floor, for `no_collision`."""

import itertools
from collections.abc import Iterator, Sequence

import msgspec
import numpy as np

from zensim.proto.messages.model_messages import Model, Shape
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.proto.se3 import FloatArray, from_origin, to_yaw, transform_points

SOLID_KINDS = ("box", "cylinder", "capsule", "sphere")
"""Shapes whose size is in the description; planes are floors, meshes are not looked at."""


class Wall(msgspec.Struct, frozen=True):
    """A rectangle: its centre [m], heading [rad] and half lengths [m]."""

    name: str
    x: float
    y: float
    yaw: float
    half_length: float
    half_width: float


def find_walls(models: GetModelsResponse, low: float, high: float) -> list[Wall]:
    """Find the static entities of the world file that reach between two heights [m]."""
    walls: list[Wall] = []
    for entity in models.entities:
        model = models.models[entity.model]
        if not entity.belongs_to_world or not model.is_static:
            continue
        position, turn = entity.initial_pose.position, entity.initial_pose.orientation
        pose = np.array([position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w])
        for shape in _list_shapes(model):
            walls += _make_wall(entity.entity, pose, shape, low, high)
    return walls


def _list_shapes(model: Model) -> Iterator[Shape]:
    # Other links of a static model may move.
    yield from (one for one in model.links[0].collisions if one.kind in SOLID_KINDS)


def _find_half_lengths(shape: Shape) -> tuple[float, float, float]:
    x, y, z = shape.size
    if shape.kind == "box":
        return x / 2.0, y / 2.0, z / 2.0
    if shape.kind == "sphere":
        return x, x, x
    return x, x, y / 2.0 + (x if shape.kind == "capsule" else 0.0)


def _make_wall(
    name: str, pose: FloatArray, shape: Shape, low: float, high: float
) -> Sequence[Wall]:
    corners = np.array(list(itertools.product(*((-a, a) for a in _find_half_lengths(shape)))))
    own = from_origin(shape.origin)
    points = transform_points(pose, transform_points(own, corners))
    if points[:, 2].max() <= low or points[:, 2].min() >= high:
        return ()
    yaw = float(to_yaw(pose[3:]) + to_yaw(own[3:]))
    ahead, left = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    along, across = points[:, :2] @ ahead, points[:, :2] @ left
    centre = (along.min() + along.max()) / 2.0 * ahead + (across.min() + across.max()) / 2.0 * left
    half = float(np.ptp(along)) / 2.0, float(np.ptp(across)) / 2.0
    return (Wall(name, float(centre[0]), float(centre[1]), yaw, *half),)
