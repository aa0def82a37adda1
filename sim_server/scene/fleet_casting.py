"""The caster of all lidars of a world: the planar one for level scans, Embree for the others."""

import math
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.sensor_messages import RaySensor
from zensim.proto.se3 import FloatArray
from zensim.proto.sensor_libraries import find_library_fault
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.planar_casting import PlanarCaster, find_tilts, make_level_scan
from zensim.sim_server.scene.ray_casting import PlacedShapes, RayCaster, cast_rays_exactly
from zensim.sim_server.scene.scan_casting import ScanCaster, cast_ray_by_ray, choose_ignored
from zensim.sim_server.scene.scene import BoolArray, SceneLayout
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
        self._planar = PlanarCaster()
        self._cast_rays = _find_ray_caster(layout)
        self._base, self._joint_positions = np.zeros((0, 7)), np.zeros(0)
        self._shapes: PlacedShapes | None = None
        """All of this step, once a lidar that is not level needs them."""
        self._placed: BoolArray | None = None
        """Entities (n,) whose shapes the planar caster has; None = not those of this step."""
        self._wanted = self._expected = np.zeros(0, np.bool_)
        """Entities near level lidars in this step, and in the one before."""

    def place(self, base: FloatArray, joint_positions: FloatArray) -> None:
        """See `ScanCaster`."""
        self._base, self._joint_positions = base[:, :7], joint_positions
        self._shapes = self._placed = None
        self._wanted, self._expected = np.zeros(len(base), np.bool_), self._wanted

    def cast(self, settings: RaySensor, poses: FloatArray, carriers: IntArray) -> FloatArray:
        """See `ScanCaster`."""
        ranges = np.empty((len(poses), settings.vertical.count * settings.horizontal.count))
        is_level = are_level(settings, poses)
        level, others = np.flatnonzero(is_level), np.flatnonzero(~is_level)
        if len(level):
            ranges[level] = self._cast_level(settings, poses[level], carriers[level])
        if len(others):
            if self._shapes is None:
                self._shapes = self._layout.place(self._base, self._joint_positions)
            ranges[others] = cast_ray_by_ray(
                self._cast_rays, self._shapes, settings, poses[others], carriers[others]
            )
        return ranges

    def _cast_level(self, settings: RaySensor, poses: FloatArray, carriers: IntArray) -> FloatArray:
        self._place_near(poses, settings.range_max_m)
        ignored, start_m = choose_ignored(settings, carriers)
        scan = make_level_scan(settings.horizontal, settings.range_max_m, start_m)
        return self._planar.cast(scan, poses, ignored)

    def _place_near(self, poses: FloatArray, range_m: float) -> None:
        """Place what level lidars can reach: the other shapes of a large fleet take most time."""
        state = self._base, self._joint_positions
        near = self._layout.find_near(self._base, poses[:, :2], range_m)
        self._wanted |= near
        if self._placed is not None and self._placed[near].all():
            return
        # Also what lidars of other settings needed before, so that it is placed once in a step.
        is_known = len(self._expected) == len(near)
        self._placed = self._wanted | self._expected if is_known else self._wanted.copy()
        moving = self._layout.place_moving(*state, self._placed)
        self._planar.place(self._layout.place_fixed(*state), moving)


class WorldsCaster:
    """Casts the level lidars of many worlds at once, which share what is fixed."""

    def __init__(
        self, fixed: PlacedShapes, moving: SceneLayout, models: int, entities: int
    ) -> None:
        """Prepare the scenes.

        Args:
            fixed: Shapes of what never moves; entities are those of one world.
            moving: Of the entities of all worlds that move, world by world.
            models: Number of them in a world.
            entities: Number of all entities of a world.
        """
        self._planar = PlanarCaster()
        self._fixed, self._moving = fixed, moving
        self._models, self._entities = models, entities

    def cast(
        self,
        settings: RaySensor,
        poses: FloatArray,
        carriers: IntArray,
        state: tuple[FloatArray, FloatArray],
    ) -> FloatArray:
        """Find the ranges (n, rays) [m] of level lidars; see `ScanCaster.cast`.

        Args:
            settings: Of all of them.
            poses: (n, 7) of the sensors in the world of each.
            carriers: (n,) index of the entity that carries each, among those of `moving`.
            state: Poses of what moves (worlds * models, 7), and joints (k,).
        """
        base, joint_positions = state
        placed = self._moving.place_moving(base, joint_positions, np.ones(len(base), np.bool_))
        # Numbers of what moves follow those of what is fixed.
        numbered = replace(placed, entity=placed.entity + self._entities)
        self._planar.place(self._fixed, numbered, placed.entity // self._models)
        ignored, start_m = choose_ignored(settings, carriers + self._entities)
        scan = make_level_scan(settings.horizontal, settings.range_max_m, start_m)
        return self._planar.cast(scan, poses, ignored, worlds=carriers // self._models)


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
