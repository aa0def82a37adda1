"""Camera images by rays, where there is no OpenGL: depth, labels, and colour shaded by normals."""

import numpy as np

from zensim.proto.messages.sensor_messages import CameraSensor
from zensim.proto.se3 import FloatArray, rotate
from zensim.sim_server.scene.camera_images import (
    CameraImages,
    Lighting,
    find_rgba,
    make_pixel_directions,
)
from zensim.sim_server.scene.embree_casting import NO_SHAPE, EmbreeCaster
from zensim.sim_server.scene.ray_casting import NO_ENTITY, PlacedShapes, Rays
from zensim.sim_server.scene.scene import SceneLayout


class RayRenderer:
    """A `CameraRenderer` by rays."""

    def __init__(self, layout: SceneLayout, lighting: Lighting) -> None:
        """Prepare a scene without poses.

        Args:
            layout: Of what cameras see.
            lighting: Of the world.
        """
        self._caster = EmbreeCaster(layout.is_fixed)
        self._lighting = lighting
        self._shapes = layout.unplaced
        colours = [find_rgba(geometry.shape)[:3] for geometry in self._shapes.geometries]
        self._colours = np.array(colours).reshape(-1, 3)

    def place(self, shapes: PlacedShapes) -> None:
        """See `CameraRenderer`."""
        self._shapes = shapes
        self._caster.place(shapes)

    def render(self, settings: CameraSensor, pose: FloatArray) -> CameraImages:
        """See `CameraRenderer`."""
        local = make_pixel_directions(settings).reshape(-1, 3)
        lengths = np.linalg.norm(local, axis=1)
        directions = rotate(pose[3:], local / lengths[:, None])
        # Rays begin at the near plane, which is farther away beside the axis.
        starts = settings.near_m * lengths
        origins = pose[:3] + starts[:, None] * directions
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
        colours = np.repeat(self._lighting.background[None], len(shape), axis=0)
        colours[seen] = self._lighting.shade(surface, points, normals[seen])
        return CameraImages(
            np.rint(colours * 255.0).astype(np.uint8).reshape(*size, 3),
            depth.reshape(size).astype(np.float32),
            labels.reshape(size),
        )
