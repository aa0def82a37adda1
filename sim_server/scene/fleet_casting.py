"""The caster of all lidars of a world: the planar one for level scans, Embree for the others."""

import math

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.sensor_messages import RaySensor
from zensim.proto.se3 import FloatArray
from zensim.proto.sensor_libraries import find_library_fault
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.planar_casting import PlanarCaster, find_tilts, make_level_scan
from zensim.sim_server.scene.ray_casting import RayCaster, cast_rays_exactly
from zensim.sim_server.scene.scan_casting import ScanCaster, cast_ray_by_ray, choose_ignored
from zensim.sim_server.scene.scene import SceneLayout
from zensim.sim_server.scene.sensor_faults import has_one_level_row

MAX_LEVEL_TILT_RAD = math.radians(2.0)
"""Up to this tilt, a scan of one row is cast as if it were level: a robot rocks by about 1 degree,
and would see the floor. Walls are r (1 / cos - 1) nearer than by the tilted ray: 6 mm at 10 m."""


class FleetCaster:
    """A `ScanCaster` that chooses for each lidar, by its settings and its pose alone."""

    def __init__(self, layout: SceneLayout) -> None:
        """Prepare a scene without poses.

        Args:
            layout: Entities and shapes.
        """
        self._layout = layout
        self._planar = PlanarCaster(layout.is_fixed)
        self._cast_rays = _find_ray_caster(layout)
        self._shapes = layout.unplaced

    def place(self, base: FloatArray, joint_positions: FloatArray) -> None:
        """See `ScanCaster`."""
        self._shapes = self._layout.place(base[:, :7], joint_positions)

    def cast(self, settings: RaySensor, poses: FloatArray, carriers: IntArray) -> FloatArray:
        """See `ScanCaster`."""
        ranges = np.empty((len(poses), settings.vertical.count * settings.horizontal.count))
        is_level = are_level(settings, poses)
        level, others = np.flatnonzero(is_level), np.flatnonzero(~is_level)
        if len(level):
            ranges[level] = self._cast_level(settings, poses[level], carriers[level])
        if len(others):
            ranges[others] = cast_ray_by_ray(
                self._cast_rays, self._shapes, settings, poses[others], carriers[others]
            )
        return ranges

    def _cast_level(self, settings: RaySensor, poses: FloatArray, carriers: IntArray) -> FloatArray:
        self._planar.place(self._shapes)
        ignored, start_m = choose_ignored(settings, carriers)
        scan = make_level_scan(settings.horizontal, settings.range_max_m, start_m)
        return self._planar.cast(scan, poses, ignored)


def are_level(settings: RaySensor, poses: FloatArray) -> npt.NDArray[np.bool_]:
    """Whether lidars at poses (n, 7) are cast as level ones: one row, hardly tilted."""
    return np.asarray(has_one_level_row(settings) & (find_tilts(poses) <= MAX_LEVEL_TILT_RAD))


def _find_ray_caster(layout: SceneLayout) -> RayCaster:
    """Make a caster of rays of any direction: Embree, or the exact one, which is slow."""
    if find_library_fault("embree"):
        return cast_rays_exactly
    # Not installed everywhere: there are no wheels for linux on arm64.
    from zensim.sim_server.scene.embree_casting import EmbreeCaster  # noqa: PLC0415

    return EmbreeCaster(layout.is_fixed)


def make_scan_caster(layout: SceneLayout) -> ScanCaster:
    """Make the caster of a scene."""
    return FleetCaster(layout)
