"""Casting of whole scans: the interface of a caster of lidars, and casting ray by ray."""

from functools import lru_cache
from typing import Protocol

import numpy as np

from zensim.proto.messages.sensor_messages import RaySensor, ScanAxis
from zensim.proto.se3 import FloatArray, rotate_all
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.ray_casting import NO_ENTITY, PlacedShapes, RayCaster, Rays


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


@lru_cache(maxsize=64)
def make_ray_directions(settings: RaySensor) -> FloatArray:
    """Make the unit vectors (rays, 3) of a scan in the sensor's axes."""
    azimuth, elevation = np.meshgrid(
        list_angles(settings.horizontal), list_angles(settings.vertical)
    )
    level = np.cos(elevation)
    parts = (level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation))
    directions = np.stack(parts, axis=-1).reshape(-1, 3)
    directions.setflags(write=False)
    return directions


def list_angles(axis: ScanAxis) -> FloatArray:
    """List the angles (count,) [rad] of an axis; a single ray has the lowest."""
    return axis.low_rad + find_increment(axis) * np.arange(axis.count, dtype=np.float64)


def find_increment(axis: ScanAxis) -> float:
    """Find the angle between two rays [rad]; 0 for a single one."""
    return (axis.high_rad - axis.low_rad) / (axis.count - 1) if axis.count > 1 else 0.0


def cast_ray_by_ray(
    cast: RayCaster,
    shapes: PlacedShapes,
    settings: RaySensor,
    poses: FloatArray,
    carriers: IntArray,
) -> FloatArray:
    """Find the ranges of lidars by a caster of rays of any direction; see `ScanCaster.cast`."""
    local = make_ray_directions(settings)
    directions = rotate_all(poses[:, 3:], local).reshape(-1, 3)
    ignored, start_m = choose_ignored(settings, carriers)
    rays = Rays(
        np.repeat(poses[:, :3], len(local), axis=0) + start_m * directions,
        directions,
        settings.range_max_m - start_m,
        np.repeat(ignored, len(local)),
    )
    return (cast(shapes, rays).ranges + start_m).reshape(len(poses), len(local))


def choose_ignored(settings: RaySensor, carriers: IntArray) -> tuple[IntArray, float]:
    """Find the entities that the rays of lidars pass through, and where the rays begin [m].

    A lidar that sees its robot does not see what is nearer than its least range, such as its own
    housing.
    """
    if settings.sees_itself:
        return np.full(len(carriers), NO_ENTITY), settings.range_min_m
    return carriers, 0.0
