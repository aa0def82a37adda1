"""What zensim uses of yourdfpy."""

from typing import IO

import numpy as np
import numpy.typing as npt

_Array = npt.NDArray[np.float64]

class Inertial:
    origin: _Array | None
    mass: float | None
    inertia: _Array | None

class Link:
    name: str
    inertial: Inertial | None

class Dynamics:
    damping: str | None
    friction: str | None

class Limit:
    effort: float | None
    velocity: float | None
    lower: float | None
    upper: float | None

class Mimic:
    joint: str
    multiplier: float | None
    offset: float | None

class Joint:
    name: str
    type: str
    parent: str
    child: str
    origin: _Array | None
    axis: _Array
    dynamics: Dynamics | None
    limit: Limit | None
    mimic: Mimic | None

class Robot:
    name: str
    links: list[Link]
    joints: list[Joint]

class URDF:
    robot: Robot
    @staticmethod
    def load(
        fname_or_file: IO[bytes], *, build_scene_graph: bool, load_meshes: bool
    ) -> URDF: ...
