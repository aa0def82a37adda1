"""What zensim uses of yourdfpy."""

from typing import IO

import numpy as np
import numpy.typing as npt

class Inertial:
    mass: float | None

class Link:
    name: str
    inertial: Inertial | None

class Robot:
    links: list[Link]

class URDF:
    robot: Robot
    @staticmethod
    def load(fname_or_file: IO[bytes], *, load_meshes: bool) -> URDF: ...
    def get_transform(self, frame_to: str, frame_from: str) -> npt.NDArray[np.float64]: ...
