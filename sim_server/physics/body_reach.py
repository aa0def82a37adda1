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
"""What engines put around a shape [m]."""

MAX_CACHED_REACHES = 256
"""Models that are remembered."""
MeshRadius = Callable[[Shape], float]
"""How far a mesh reaches from its own frame [m]; raises OSError when it is not there."""
MAX_REACH_M = 1e6
"""What has no end reaches over all of the world."""


@dataclass(frozen=True)
class BodyReach:
    """Bounds of a body about its root.

    Attributes:
        radius_m: Of a ball about the root link that holds all shapes, slides at zero.
        arm_m: From the root to its centre of mass.
        slides: Places of the joints that slide, among `Model.joints`.
        levers: (k,) how far from its axis each target moves ground or others [m]; 1 for speeds.
    """

    radius_m: float
    com_offset_m: float
    slides: tuple[int, ...]
    levers: FloatArray


def measure_reach(model: Model, farthest: MeshRadius) -> BodyReach:
    """Measure a model; raises as `farthest` does."""
    own = [_link_radius(link, farthest) for link in model.links]
    index = {link.name: i for i, link in enumerate(model.links)}
    away = [0.0] * len(model.links)
    for child, joint in enumerate(model.joints, start=1):
        away[child] = away[index[joint.parent]] + _norm(joint.origin.position)
    return BodyReach(
        radius_m=min(max(map(sum, zip(away, own, strict=True))) + SHAPE_MARGIN_M, MAX_REACH_M),
        com_offset_m=_norm(model.links[0].inertial.com_in_link),
        slides=tuple(i for i, joint in enumerate(model.joints) if joint.kind == "prismatic"),
        levers=_measure_levers(model, own),
    )


def can_move(model: Model) -> bool:
    """Whether any part of a model moves."""
    return not model.is_static or any(joint.kind != "fixed" for joint in model.joints)


def _measure_levers(model: Model, own: list[float]) -> FloatArray:
    plan = make_actuation(model)
    levers = np.zeros(plan.width)
    for joint, place in zip(plan.speeds.joints, plan.speeds.columns, strict=True):
        levers[place] = own[joint + 1]
    if plan.twist is not None:
        levers[plan.twist : plan.twist + 3] = 1.0, 1.0, max(own)
    return levers


def _link_radius(link: Link, farthest: MeshRadius) -> float:
    return max((_shape_radius(shape, farthest) for shape in link.collisions), default=0.0)


def _shape_radius(shape: Shape, farthest: MeshRadius) -> float:
    """Find how far a shape reaches from the frame of its link."""
    length, width, height = shape.size
    if shape.kind == "mesh":
        size = farthest(shape)
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


class ReachCache:
    """Measures models, and remembers them: meshes take long."""

    def __init__(self, mesh_folder: str) -> None:
        self._mesh_folder = mesh_folder
        self._known: dict[int, tuple[Model, BodyReach]] = {}
        self._mesh_radii: dict[tuple[str, Vec3], float] = {}

    def prepare(self, model: Model) -> bool:
        """Measure one mesh of a model; say whether none is left, or one is not there."""
        meshes = (shape for link in model.links for shape in link.collisions if shape.mesh)
        for shape in meshes:
            if (shape.mesh, shape.size) not in self._mesh_radii:
                with suppress(OSError):
                    self.mesh_radius(shape)
                    return False
        return True

    def mesh_radius(self, shape: Shape) -> float:
        """Measure a mesh; raises OSError when it is not in the folder."""
        key = (shape.mesh, shape.size)
        if key not in self._mesh_radii:
            corners = read_corners(Path(self._mesh_folder, f"{shape.mesh}.stl").read_bytes())
            arms = np.linalg.norm(corners * np.array(shape.size), axis=1)
            self._mesh_radii[key] = float(arms.max(initial=0.0))
        return self._mesh_radii[key]

    def measure(self, model: Model) -> BodyReach:
        """Measure a model."""
        # Whoever is kept here keeps its identity.
        if (known := self._known.get(id(model))) is not None:
            return known[1]
        if len(self._known) >= MAX_CACHED_REACHES:
            self._known.clear()
            self._mesh_radii.clear()
        found = measure_reach(model, self.mesh_radius)
        self._known[id(model)] = model, found
        return found
