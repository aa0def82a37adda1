"""Casting of whole scans: the interface of a caster of lidars, and an exact one on arrays."""

from typing import Protocol

import numpy as np

from zensim.proto.messages.sensor_messages import RaySensor, ScanAxis
from zensim.proto.se3 import FloatArray, rotate
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.ray_casting import NO_ENTITY, RayCaster, Rays, cast_rays_exactly
from zensim.sim_server.scene.scene import CollisionScene, SceneLayout


class ScanCaster(Protocol):
    """Finds the ranges of lidars in one scene."""

    def place(self, base: FloatArray, joint_positions: FloatArray) -> None:
        """Take the poses of a step.

        Args:
            base: (n, 7) or more columns: poses of the root links in the world.
            joint_positions: (k,) of all entities, in the order of `Model.joints`.
        """

    def cast(self, settings: RaySensor, poses: FloatArray, carriers: IntArray) -> FloatArray:
        """Find the ranges of lidars with equal settings.

        Args:
            settings: Of all of them.
            poses: (m, 7) of the sensors in the world.
            carriers: (m,) indices of the entities that carry them, which their rays pass through
                unless `settings.sees_itself`.

        Returns:
            (m, rays) [m], rows of the vertical axis one after another; infinite where nothing is
            hit within `range_max_m`.
        """


def make_ray_directions(settings: RaySensor) -> FloatArray:
    """Make the unit vectors (rays, 3) of a scan in the sensor's axes."""
    azimuth, elevation = np.meshgrid(
        list_angles(settings.horizontal), list_angles(settings.vertical)
    )
    level = np.cos(elevation)
    parts = (level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation))
    return np.stack(parts, axis=-1).reshape(-1, 3)


def list_angles(axis: ScanAxis) -> FloatArray:
    """List the angles (count,) [rad] of an axis; a single ray has the lowest."""
    return axis.low_rad + find_increment(axis) * np.arange(axis.count, dtype=np.float64)


def find_increment(axis: ScanAxis) -> float:
    """Find the angle between two rays [rad]; 0 for a single one."""
    return (axis.high_rad - axis.low_rad) / (axis.count - 1) if axis.count > 1 else 0.0


class RayByRayCaster:
    """A `ScanCaster` that casts each ray by itself."""

    def __init__(self, layout: SceneLayout, cast: RayCaster = cast_rays_exactly) -> None:
        """Prepare a scene without poses.

        Args:
            layout: Entities and shapes.
            cast: Finds the first hits of rays.
        """
        self._layout = layout
        self._cast = cast
        self._scene: CollisionScene | None = None

    def place(self, base: FloatArray, joint_positions: FloatArray) -> None:
        """See `ScanCaster`."""
        self._scene = CollisionScene(self._layout, base, joint_positions)

    def cast(self, settings: RaySensor, poses: FloatArray, carriers: IntArray) -> FloatArray:
        """See `ScanCaster`.

        Raises:
            ValueError: There are no poses yet.
        """
        if self._scene is None:
            raise ValueError("the scene has no poses; call place first")
        directions = make_ray_directions(settings)
        count = len(directions)
        turned = rotate(
            np.repeat(poses[:, 3:], count, axis=0), np.tile(directions, (len(poses), 1))
        )
        ignored = np.full(len(poses), NO_ENTITY) if settings.sees_itself else carriers
        rays = Rays(
            np.repeat(poses[:, :3], count, axis=0),
            turned,
            settings.range_max_m,
            np.repeat(ignored, count),
        )
        return self._cast(self._scene.shapes, rays).ranges.reshape(len(poses), count)


def make_scan_caster(layout: SceneLayout) -> ScanCaster:
    """Make the caster of a scene."""
    return RayByRayCaster(layout)
