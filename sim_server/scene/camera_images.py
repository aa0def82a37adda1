"""Images of cameras: what a renderer makes, the pinhole model, and the light in a world.

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

from zensim.proto.messages.model_messages import Light, Link, Quat, Shape
from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.messages.world_messages import Scene
from zensim.proto.se3 import FloatArray
from zensim.sim_server.scene.ray_casting import PlacedShapes

VISUAL_RGBA: Quat = (0.72, 0.74, 0.77, 1.0)
"""Colour of what has none."""
GROUND_RGBA: Quat = (0.55, 0.56, 0.58, 1.0)
SKY_RGB = (0.70, 0.76, 0.84)
AMBIENT_RGB = (0.40, 0.40, 0.40)
"""Where a world specifies no ambient light."""
SUN = Light("sun", "directional", direction=(-0.5, 0.1, -0.9), rgba=(0.8, 0.8, 0.8, 1.0))
"""That of `model://sun`; also where a world has no light."""
MAX_LIGHTS = 8


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

    def place(self, shapes: PlacedShapes) -> None:
        """Take the poses of one step; `shapes` are those of `list_visible_shapes`."""

    def render(self, settings: CameraSensor, pose: FloatArray) -> CameraImages:
        """Make the images of a camera at a pose (7,) in the world.

        Surfaces nearer than `near_m` or farther than `far_m` are not seen.
        """


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
        if (shape.kind != "mesh" or has_mesh(shape.mesh)) and not _is_transparent(shape)
    )


def _is_transparent(shape: Shape) -> bool:
    return shape.rgba is not None and shape.rgba[3] == 0.0


def find_rgba(shape: Shape) -> Quat:
    """Find the colour of a shape."""
    if shape.rgba is not None:
        return shape.rgba
    return GROUND_RGBA if shape.kind == "plane" else VISUAL_RGBA


@dataclass(frozen=True)
class Lighting:
    """Lights of a world: diffuse light without shadows.

    Attributes:
        ambient: (3,) red, green, blue.
        background: (3,).
        places: (k, 4) position [m] and 1, or unit vector towards a directional light and 0.
        colours: (k, 3).
    """

    ambient: FloatArray
    background: FloatArray
    places: FloatArray
    colours: FloatArray

    def shade(self, colours: FloatArray, points: FloatArray, normals: FloatArray) -> FloatArray:
        """Find the colours (n, 3) of surfaces of these colours at points with unit normals."""
        light = np.repeat(self.ambient[None], len(points), axis=0)
        for place, colour in zip(self.places, self.colours, strict=True):
            towards = place[:3] - place[3] * points
            lengths = np.maximum(np.linalg.norm(towards, axis=1), 1e-9)
            share = np.maximum(np.einsum("ij,ij->i", towards, normals) / lengths, 0.0)
            light += share[:, None] * colour
        return np.minimum(colours * light, 1.0)


def make_lighting(scene: Scene) -> Lighting:
    """Make the lights of a world; the first ones, if there are too many."""
    lights = [*scene.lights, *([SUN] if scene.has_sun or not scene.lights else [])][:MAX_LIGHTS]
    return Lighting(
        np.array(scene.ambient[:3] if scene.ambient else AMBIENT_RGB),
        np.array(scene.background[:3] if scene.background else SKY_RGB),
        np.array([_place_light(light) for light in lights]).reshape(-1, 4),
        np.array([light.rgba[:3] for light in lights]).reshape(-1, 3),
    )


def _place_light(light: Light) -> tuple[float, float, float, float]:
    if light.kind != "directional":
        return (*light.origin.position, 1.0)
    x, y, z = light.direction
    length = math.hypot(x, y, z) or 1.0
    return (-x / length, -y / length, -z / length, 0.0)
