"""Bounds on how far a body reaches from its root link, and how fast its actuators move it."""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from zensim.proto.messages.model_messages import Link, Model, Shape, Vec3
from zensim.proto.stl import read_corners
from zensim.sim_server.physics.actuation import make_actuation
from zensim.sim_server.physics.engine import FloatArray

SHAPE_MARGIN_M = 1e-3
"""Collision margin of engines around a shape [m]."""

MAX_CACHED_REACHES = 256
"""Measured models in a cache."""
MAX_CACHED_RADII = 16_384
"""Measured meshes of a process, besides those of models that are prepared."""
MeshRadius = Callable[[Shape], float]
"""Radius of a mesh about its frame [m]; raises OSError when its file is missing."""
MAX_REACH_M = 1e6
"""Radius of an infinite shape."""


@dataclass(frozen=True)
class BodyReach:
    """Bounds of a body about its root.

    Attributes:
        radius_m: Of the sphere about the root link that holds all shapes, prismatic joints at zero.
        com_offset_m: From the root to its centre of mass.
        slides: Indexes of the prismatic joints in `Model.joints`.
        levers: (k,) surface speed per unit of each target: a radius [m], or 1 for linear speeds.
    """

    radius_m: float
    com_offset_m: float
    slides: tuple[int, ...]
    levers: FloatArray


def measure_reach(model: Model, mesh_radius: MeshRadius) -> BodyReach:
    """Measure a model; raises as `mesh_radius` does."""
    own = [_link_radius(link, mesh_radius) for link in model.links]
    index = {link.name: i for i, link in enumerate(model.links)}
    distance = [0.0] * len(model.links)
    for child, joint in enumerate(model.joints, start=1):
        distance[child] = distance[index[joint.parent]] + _norm(joint.origin.position)
    return BodyReach(
        radius_m=min(max(map(sum, zip(distance, own, strict=True))) + SHAPE_MARGIN_M, MAX_REACH_M),
        com_offset_m=_norm(model.links[0].inertial.com_in_link),
        slides=tuple(i for i, joint in enumerate(model.joints) if joint.kind == "prismatic"),
        levers=_measure_levers(model, own),
    )


def _measure_levers(model: Model, own: list[float]) -> FloatArray:
    actuation = make_actuation(model)
    speeds, twist = actuation.speeds, actuation.twist
    levers = np.zeros(actuation.width)
    for joint, column in zip(speeds.joints, speeds.columns, strict=True):
        levers[column] = own[joint + 1]
    if twist is not None:
        levers[twist : twist + 3] = 1.0, 1.0, max(own)
    return levers


def _link_radius(link: Link, mesh_radius: MeshRadius) -> float:
    return max((_shape_radius(shape, mesh_radius) for shape in link.collisions), default=0.0)


def _shape_radius(shape: Shape, mesh_radius: MeshRadius) -> float:
    """Find the radius [m] of a shape about the frame of its link."""
    length, width, height = shape.size
    if shape.kind == "mesh":
        size = mesh_radius(shape)
    else:
        size = {
            "box": math.hypot(length, width, height) / 2.0,
            "sphere": length,
            "cylinder": math.hypot(length, width / 2.0),
            "capsule": length + width / 2.0,
            "plane": math.inf,
        }[shape.kind]
    return _norm(shape.origin.position) + size


def _norm(vector: Vec3) -> float:
    return math.hypot(*vector)


_MESH_RADII: dict[tuple[str, Vec3], float] = {}
"""Radius [m] by file, which is named by its content, and scale.

The layers of an engine and its cells measure the same models; a mesh takes milliseconds.
"""


class ReachCache:
    """Measures models and caches the result: meshes are slow."""

    def __init__(self, mesh_folder: str) -> None:
        self._mesh_folder = mesh_folder
        self._reaches: dict[int, tuple[Model, BodyReach]] = {}

    def __getstate__(self) -> dict[str, object]:
        """Leave out what is cached by the identity of models."""
        return {**self.__dict__, "_reaches": {}}

    def prepare(self, model: Model) -> bool:
        """Measure one mesh of a model; return whether none is left, or its file is missing."""
        meshes = (shape for link in model.links for shape in link.collisions if shape.mesh)
        for shape in meshes:
            if (self._find_file(shape), shape.size) not in _MESH_RADII:
                with suppress(OSError):
                    self.mesh_radius(shape)
                    return False
        return True

    def mesh_radius(self, shape: Shape) -> float:
        """Measure a mesh; raises OSError when its file is missing."""
        file = self._find_file(shape)
        if (radius_m := _MESH_RADII.get((file, shape.size))) is None:
            corners = read_corners(Path(file).read_bytes())
            arms = np.linalg.norm(corners * np.array(shape.size), axis=1)
            radius_m = float(arms.max(initial=0.0))
            _MESH_RADII[file, shape.size] = radius_m
        return radius_m

    def _find_file(self, shape: Shape) -> str:
        return f"{self._mesh_folder}/{shape.mesh}.stl"

    def measure(self, model: Model) -> BodyReach:
        """Measure a model."""
        # The cached model is referenced, so its id is not reused.
        if (known := self._reaches.get(id(model))) is not None:
            return known[1]
        if len(self._reaches) >= MAX_CACHED_REACHES:
            self._reaches.clear()
        found = measure_reach(model, self.mesh_radius)
        if len(_MESH_RADII) > MAX_CACHED_RADII:  # not before: `prepare` would never end
            _MESH_RADII.clear()
        self._reaches[id(model)] = model, found
        return found
