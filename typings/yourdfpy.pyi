"""What zensim uses of yourdfpy."""

from typing import IO

import numpy as np
import numpy.typing as npt

_Array = npt.NDArray[np.float64]

class Box:
    size: _Array

class Cylinder:
    radius: float
    length: float

class Sphere:
    radius: float

class Mesh:
    filename: str
    scale: float | _Array | None

class Geometry:
    box: Box | None
    cylinder: Cylinder | None
    sphere: Sphere | None
    mesh: Mesh | None

class Color:
    rgba: _Array

class Material:
    name: str | None
    color: Color | None

class Visual:
    name: str | None
    origin: _Array | None
    geometry: Geometry
    material: Material | None

class Collision:
    name: str | None
    origin: _Array | None
    geometry: Geometry

class Inertial:
    origin: _Array | None
    mass: float | None
    inertia: _Array | None

class Link:
    name: str
    inertial: Inertial | None
    visuals: list[Visual]
    collisions: list[Collision]

class Dynamics:
    damping: str | None
    friction: str | None

class Limit:
    effort: float | None
    velocity: float | None
    lower: float | None
    upper: float | None

class Joint:
    name: str
    type: str
    parent: str
    child: str
    origin: _Array | None
    axis: _Array
    dynamics: Dynamics | None
    limit: Limit | None

class Robot:
    name: str
    links: list[Link]
    joints: list[Joint]
    materials: list[Material]

class URDF:
    robot: Robot
    @staticmethod
    def load(
        fname_or_file: IO[bytes], *, build_scene_graph: bool, load_meshes: bool
    ) -> URDF: ...
