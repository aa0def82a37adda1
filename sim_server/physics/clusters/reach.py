"""How far a model reaches from its root, whatever its joints do; how fast its motors move it."""

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

BEYOND = 1e-3
"""What engines put around a shape [m]."""

KNOWN = 256
"""Models that are remembered."""
Farthest = Callable[[Shape], float]
"""How far a mesh reaches from its own frame [m]; raises OSError when it is not there."""
FARTHEST_M = 1e6
"""What has no end reaches over all of the world."""


@dataclass(frozen=True)
class Reach:
    """Bounds of a body about its root.

    Attributes:
        radius_m: Of a ball about the root link that holds all shapes, slides at zero.
        arm_m: From the root to its centre of mass.
        slides: Places of the joints that slide, among `Model.joints`.
        levers: (k,) how far from its axis each target moves ground or others [m]; 1 for speeds.
    """

    radius_m: float
    arm_m: float
    slides: tuple[int, ...]
    levers: FloatArray


def reach_of(model: Model, farthest: Farthest) -> Reach:
    """Measure a model; raises as `farthest` does."""
    own = [_extent(link, farthest) for link in model.links]
    index = {link.name: i for i, link in enumerate(model.links)}
    away = [0.0] * len(model.links)
    for child, joint in enumerate(model.joints, start=1):
        away[child] = away[index[joint.parent]] + _length(joint.origin.position)
    return Reach(
        radius_m=min(max(map(sum, zip(away, own, strict=True))) + BEYOND, FARTHEST_M),
        arm_m=_length(model.links[0].inertial.com_in_link),
        slides=tuple(i for i, joint in enumerate(model.joints) if joint.kind == "prismatic"),
        levers=_levers(model, own),
    )


def moves(model: Model) -> bool:
    """Whether any part of a model moves."""
    return not model.is_static or any(joint.kind != "fixed" for joint in model.joints)


def _levers(model: Model, own: list[float]) -> FloatArray:
    plan = make_actuation(model)
    levers = np.zeros(plan.width)
    for joint, place in zip(plan.speeds.joints, plan.speeds.places, strict=True):
        levers[place] = own[joint + 1]
    if plan.twist is not None:
        levers[plan.twist : plan.twist + 3] = 1.0, 1.0, max(own)
    return levers


def _extent(link: Link, farthest: Farthest) -> float:
    return max((_radius(shape, farthest) for shape in link.collisions), default=0.0)


def _radius(shape: Shape, farthest: Farthest) -> float:
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
    return _length(shape.origin.position) + size


def _length(vector: Vec3) -> float:
    return math.hypot(*vector)


class Measure:
    """Measures models, and remembers them: meshes take long."""

    def __init__(self, mesh_folder: str) -> None:
        self._mesh_folder = mesh_folder
        self._known: dict[int, tuple[Model, Reach]] = {}
        self._farthest: dict[tuple[str, Vec3], float] = {}

    def prepare(self, model: Model) -> bool:
        """Measure one mesh of a model; say whether none is left, or one is not there."""
        meshes = (shape for link in model.links for shape in link.collisions if shape.mesh)
        for shape in meshes:
            if (shape.mesh, shape.size) not in self._farthest:
                with suppress(OSError):
                    self.farthest(shape)
                    return False
        return True

    def farthest(self, shape: Shape) -> float:
        """Measure a mesh; raises OSError when it is not in the folder."""
        key = (shape.mesh, shape.size)
        if key not in self._farthest:
            corners = read_corners(Path(self._mesh_folder, f"{shape.mesh}.stl").read_bytes())
            arms = np.linalg.norm(corners * np.array(shape.size), axis=1)
            self._farthest[key] = float(arms.max(initial=0.0))
        return self._farthest[key]

    def reach(self, model: Model) -> Reach:
        """Measure a model."""
        # Whoever is kept here keeps its identity.
        if (known := self._known.get(id(model))) is not None:
            return known[1]
        if len(self._known) >= KNOWN:
            self._known.clear()
            self._farthest.clear()
        found = reach_of(model, self.farthest)
        self._known[id(model)] = model, found
        return found
