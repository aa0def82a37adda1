"""Camera images by rays, where there is no OpenGL: depth, labels, and colour shaded by normals."""

from functools import lru_cache

import numpy as np

from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.se3 import FloatArray, rotate_all
from zensim.sim_server.scene.camera_images import CameraImages, find_rgba, make_pixel_directions
from zensim.sim_server.scene.embree_casting import NO_SHAPE, EmbreeCaster
from zensim.sim_server.scene.ray_casting import NO_ENTITY, PlacedShapes, Rays
from zensim.sim_server.scene.scene import SceneLayout
from zensim.sim_server.scene.scene_lights import DARKNESS, Lighting


class RayRenderer:
    """A `CameraRenderer` by rays."""

    def __init__(self, layout: SceneLayout) -> None:
        """Prepare a scene without poses.

        Args:
            layout: Of what cameras see.
        """
        self._caster = EmbreeCaster(layout.is_fixed)
        self._lighting = DARKNESS
        self._shapes = layout.unplaced
        colours = [find_rgba(geometry.shape)[:3] for geometry in self._shapes.geometries]
        self._colours = np.array(colours).reshape(-1, 3)

    def place(self, shapes: PlacedShapes, lighting: Lighting) -> None:
        """See `CameraRenderer`."""
        self._shapes, self._lighting = shapes, lighting
        self._caster.place(shapes)

    def render(self, settings: CameraSensor, pose: FloatArray) -> CameraImages:
        """See `CameraRenderer`."""
        local, lengths = _make_pixel_rays(settings)
        directions = rotate_all(pose[3:], local)
        # Rays begin at the near plane, which is farther away beside the axis.
        origins = pose[:3] + settings.near_m * lengths[:, None] * directions
        far_m = settings.far_m * float(lengths.max(initial=1.0))
        rays = Rays(origins, directions, far_m, np.full(len(origins), NO_ENTITY))
        ranges, shape, normals = self._caster.find_surfaces(rays)
        depth = ranges / lengths + settings.near_m
        shape = np.where(depth <= settings.far_m, shape, NO_SHAPE)
        depth[shape == NO_SHAPE] = np.inf
        size = settings.height, settings.width
        seen = np.flatnonzero(shape != NO_SHAPE)
        labels = np.full(len(shape), NO_ENTITY, np.int32)
        labels[seen] = self._shapes.entity[shape[seen]]
        points = origins[seen] + ranges[seen, None] * directions[seen]
        surface = self._colours[self._shapes.geometry[shape[seen]]]
        lighting = self._lighting.choose_brightest(pose[:3])
        colours = np.repeat(lighting.background[None], len(shape), axis=0)
        colours[seen] = lighting.shade(surface, points, normals[seen])
        return CameraImages(
            np.rint(colours * 255.0).astype(np.uint8).reshape(*size, 3),
            depth.reshape(size).astype(np.float32),
            labels.reshape(size),
        )


@lru_cache(maxsize=8)
def _make_pixel_rays(settings: CameraSensor) -> tuple[FloatArray, FloatArray]:
    """Make the unit vectors (h w, 3) of the pixels, and their lengths at depth 1."""
    local = make_pixel_directions(settings).reshape(-1, 3)
    lengths = np.linalg.norm(local, axis=1)
    local /= lengths[:, None]
    for array in (local, lengths):
        array.setflags(write=False)
    return local, lengths
