"""Images of cameras: what a renderer makes, and the pinhole model.

Images are in optical axes (REP-103): x right, y down, z forward; the sensor looks along its x axis,
with y to the left and z up. The centre of the pixel in column u and row v has the direction
(u - cx) / f, (v - cy) / f, 1.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.model_messages import Link, Quat, Shape
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.se3 import FloatArray
from zensim.sim_server.scene.ray_casting import PlacedShapes
from zensim.sim_server.scene.scene_lights import Lighting

VISUAL_RGBA: Quat = (0.72, 0.74, 0.77, 1.0)
"""Colour of what has none."""
GROUND_RGBA: Quat = (0.55, 0.56, 0.58, 1.0)


@dataclass(frozen=True)
class CameraImages:
    """Images (h, w) of one camera.

    Attributes:
        rgb: (h, w, 3), uint8.
        depth: (h, w) distance [m] along the optical axis, float32; infinite where nothing is seen.
        labels: (h, w) index of the entity that is seen, `GROUND` or `NO_ENTITY`, int32.
    """

    rgb: npt.NDArray[np.uint8]
    depth: npt.NDArray[np.float32]
    labels: npt.NDArray[np.int32]


class CameraRenderer(Protocol):
    """Makes the images of cameras in one scene."""

    def place(self, shapes: PlacedShapes, lighting: Lighting) -> None:
        """Take the poses of one step; `shapes` are those of `list_visible_shapes`."""

    def render(self, settings: CameraSensor, pose: FloatArray) -> CameraImages:
        """Make the images of a camera at a pose (7,) in the world.

        Surfaces nearer than `near_m` or farther than `far_m` are not seen.
        """


class TextureFiles(Protocol):
    """The files of `Texture`, by their sha256."""

    def find_picture(self, image: str) -> npt.NDArray[np.uint8] | None:
        """Find an image (h, w, 3), the upper row first; None if it cannot be read."""

    def find_places(self, coordinates: str) -> npt.NDArray[np.float32]:
        """Find the places (n, 2) of corners in an image; n = 0 if they cannot be read."""


class CamerasUnavailable(Exception):
    """No renderer can be made here; the message says what to install."""


def find_focal_length(settings: CameraSensor) -> float:
    """Find f [pixels]; pixels are square."""
    return settings.width / (2.0 * math.tan(settings.horizontal_fov_rad / 2.0))


def find_principal_point(settings: CameraSensor) -> tuple[float, float]:
    """Find cx and cy [pixels], as gz-sim does."""
    return settings.width / 2.0, settings.height / 2.0


def make_pixel_directions(settings: CameraSensor) -> FloatArray:
    """Make the directions (h, w, 3) of the pixels in the sensor's axes, of depth 1."""
    focal, (cx, cy) = find_focal_length(settings), find_principal_point(settings)
    u, v = np.meshgrid(np.arange(settings.width), np.arange(settings.height))
    return np.stack([np.ones(u.shape), (cx - u) / focal, (cy - v) / focal], axis=-1)


def list_visible_shapes(link: Link, has_mesh: Callable[[str], bool]) -> tuple[Shape, ...]:
    """List what cameras see of a link: its visuals, or its collisions if no mesh of them is there.

    Args:
        link: Of any model.
        has_mesh: Whether a `Shape.mesh` is there.
    """
    shapes = _keep_drawable(link.visuals, has_mesh)
    return shapes if shapes or not link.visuals else _keep_drawable(link.collisions, has_mesh)


def _keep_drawable(shapes: tuple[Shape, ...], has_mesh: Callable[[str], bool]) -> tuple[Shape, ...]:
    return tuple(
        shape
        for shape in shapes
        if (shape.kind != "mesh" or has_mesh(shape.mesh))
        and (shape.rgba is None or shape.rgba[3] != 0.0)
    )


def find_rgba(shape: Shape) -> Quat:
    """Find the colour of a shape."""
    if shape.rgba is not None:
        return shape.rgba
    return GROUND_RGBA if shape.kind == "plane" else VISUAL_RGBA
