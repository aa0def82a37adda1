"""Lidars and range finders: scans of a scene as LaserScan, PointCloud2, PointCloud and Range."""

from collections.abc import Callable, Sequence
from typing import Protocol

import msgspec
import numpy as np

from zensim.proto.messages.drive_messages import Compat
from zensim.proto.messages.sensor_messages import RaySensor
from zensim.proto.messages.standard_messages import (
    Header,
    LaserScan,
    Point32,
    PointCloud,
    PointCloud2,
    PointField,
    Range,
)
from zensim.proto.se3 import FloatArray
from zensim.proto.sensor_noise import SensorNoise
from zensim.proto.topic_catalog import POINT_CLOUD, POINTS, RANGE, SCAN
from zensim.sim_server.scene.broad_phase import IntArray
from zensim.sim_server.scene.scan_casting import find_increment, make_ray_directions
from zensim.sim_server.sensors.array_messages import ArrayMessages, split_rows
from zensim.sim_server.sensors.scene_roster import SceneRoster, SceneSensor
from zensim.sim_server.sensors.sensor_groups import SceneMoment, SensedScene, SensorGroup
from zensim.sim_server.sensors.sensor_publishers import SensorTopics

NOTHING_IN_RANGE_GAZEBO = float(np.finfo(np.float32).max)
"""Range of a Range message in Gazebo Classic where nothing is hit."""
UINT16, FLOAT32 = 4, 7
"""`PointField.datatype`."""
POINT_FIELDS = tuple(
    PointField(name, 4 * number, FLOAT32, 1)
    for number, name in enumerate(("x", "y", "z", "intensity"))
)
POINT_STEP = 16
RING_POINT = np.dtype([("point", "<f4", 4), ("ring", "<u2")])
"""A point with `POINT_FIELDS` and the number of its row."""


class ScanWriter(Protocol):
    """Writes the measurements of a group as messages of one topic."""

    def write(self, rows: IntArray, time_ns: int, ranges: FloatArray) -> list[bytes]:
        """Write the messages of some rows; ranges are (m, vertical, horizontal)."""


def limit_ranges(ranges: FloatArray, settings: RaySensor) -> FloatArray:
    """Replace ranges [m] below the minimum by -inf and those above the maximum by +inf."""
    limited = np.where(ranges < settings.range_min_m, -np.inf, ranges)
    return np.where(limited > settings.range_max_m, np.inf, limited)


class LaserScanWriter:
    """Writes the middle row as LaserScan."""

    def __init__(self, settings: RaySensor, frames: Sequence[str], compat: Compat) -> None:
        """Encode the templates of sensors with these frames."""
        axis = settings.horizontal
        is_single = axis.count == 1
        has_zeros = compat == "gazebo11"
        template = LaserScan(
            angle_min=axis.low_rad,
            angle_max=axis.low_rad if is_single else axis.high_rad,
            angle_increment=np.nan if is_single and has_zeros else find_increment(axis),
            range_min=settings.range_min_m,
            range_max=settings.range_max_m,
            intensities=(max(0.0, settings.min_intensity),) * axis.count if has_zeros else (),
        )
        self._count = axis.count
        self._messages = ArrayMessages(_in_frames(template, frames), array="ranges", item=(0.0,))

    def write(self, rows: IntArray, time_ns: int, ranges: FloatArray) -> list[bytes]:
        """See `ScanWriter`."""
        self._messages.fill(rows, time_ns, lengths=self._count)
        middle = ranges[:, ranges.shape[1] // 2]
        return self._messages.write(rows, split_rows(middle.astype("<f4")))


class RangeWriter:
    """Writes the least range of all rays as Range."""

    def __init__(self, settings: RaySensor, frames: Sequence[str], compat: Compat) -> None:
        """Encode the templates of sensors with these frames."""
        axes = settings.horizontal, settings.vertical
        template = Range(
            radiation_type=settings.radiation_type,
            field_of_view=max(axis.high_rad - axis.low_rad for axis in axes),
            min_range=settings.range_min_m,
            max_range=settings.range_max_m,
        )
        self._nothing = NOTHING_IN_RANGE_GAZEBO if compat == "gazebo11" else np.inf
        self._messages = ArrayMessages(_in_frames(template, frames), numbers=("range",))

    def write(self, rows: IntArray, time_ns: int, ranges: FloatArray) -> list[bytes]:
        """See `ScanWriter`."""
        least = ranges.reshape(len(ranges), -1).min(axis=1)
        least = np.where(least == np.inf, self._nothing, least)
        self._messages.fill(rows, time_ns, numbers=least[:, None])
        return self._messages.write(rows, [b""] * len(rows))


class PointsWriter:
    """Writes the finite points as PointCloud2: x, y, z and the least intensity, as Gazebo does."""

    def __init__(self, settings: RaySensor, frames: Sequence[str], _: Compat) -> None:
        """Encode the templates of sensors with these frames."""
        template = PointCloud2(height=1, fields=POINT_FIELDS, point_step=POINT_STEP, is_dense=True)
        self._directions = make_ray_directions(settings)
        self._intensity = max(0.0, settings.min_intensity)
        self._messages = ArrayMessages(
            _in_frames(template, frames), array="data", item=b"\1", integers=("width", "row_step")
        )

    def write(self, rows: IntArray, time_ns: int, ranges: FloatArray) -> list[bytes]:
        """See `ScanWriter`."""
        points = _find_points(self._directions, ranges)
        counts = np.array([len(one) for one in points], dtype=np.intp)
        sizes = counts * POINT_STEP
        self._messages.fill(
            rows, time_ns, lengths=sizes, integers=np.stack([counts, sizes], axis=1)
        )
        filled = [_add_intensity(one, self._intensity).tobytes() for one in points]
        return self._messages.write(rows, filled)


class OrganizedPointsWriter:
    """Writes all points as PointCloud2, with their row as `ring`, as gz-sim does.

    The coordinates of rays without a hit are infinite, or NaN along an axis.
    """

    def __init__(self, settings: RaySensor, frames: Sequence[str], _: Compat) -> None:
        """Encode the templates of sensors with these frames."""
        height, width = settings.vertical.count, settings.horizontal.count
        template = PointCloud2(
            height=height,
            width=width,
            fields=(*POINT_FIELDS, PointField("ring", POINT_STEP, UINT16, 1)),
            point_step=RING_POINT.itemsize,
            row_step=RING_POINT.itemsize * width,
        )
        self._directions = make_ray_directions(settings)
        self._rings = np.repeat(np.arange(height), width)
        self._messages = ArrayMessages(_in_frames(template, frames), array="data", item=b"\1")

    def write(self, rows: IntArray, time_ns: int, ranges: FloatArray) -> list[bytes]:
        """See `ScanWriter`."""
        points = np.zeros((len(ranges), len(self._rings)), RING_POINT)
        with np.errstate(invalid="ignore"):  # no hit, along an axis
            places = self._directions * ranges.reshape(len(ranges), -1, 1)
        points["point"][..., :3] = places
        points["ring"] = self._rings
        self._messages.fill(rows, time_ns, lengths=points[0].nbytes if len(points) else 0)
        return self._messages.write(rows, split_rows(points))


def make_points_writer(settings: RaySensor, frames: Sequence[str], compat: Compat) -> ScanWriter:
    """Make the writer of PointCloud2."""
    make = OrganizedPointsWriter if settings.is_organized else PointsWriter
    return make(settings, frames, compat)


class PointCloudWriter:
    """Writes the finite points as PointCloud without channels."""

    def __init__(self, settings: RaySensor, frames: Sequence[str], _: Compat) -> None:
        """Encode the templates of sensors with these frames."""
        self._directions = make_ray_directions(settings)
        self._messages = ArrayMessages(
            _in_frames(PointCloud(), frames), array="points", item=(Point32(),)
        )

    def write(self, rows: IntArray, time_ns: int, ranges: FloatArray) -> list[bytes]:
        """See `ScanWriter`."""
        points = _find_points(self._directions, ranges)
        counts = np.array([len(one) for one in points], dtype=np.intp)
        self._messages.fill(rows, time_ns, lengths=counts)
        return self._messages.write(rows, [one.astype("<f4").tobytes() for one in points])


MakeScanWriter = Callable[[RaySensor, Sequence[str], Compat], ScanWriter]
SCAN_WRITERS: dict[str, MakeScanWriter] = {
    SCAN.name: LaserScanWriter,
    RANGE.name: RangeWriter,
    POINTS.name: make_points_writer,
    POINT_CLOUD.name: PointCloudWriter,
}
RAYS_AT_ONCE = 1 << 16
"""Rays that are measured before their messages are published: the first scan of a large fleet does
not wait for the last one, and memory is bounded."""


class RaySensorGroup(SensorGroup):
    """Lidars or range finders with equal settings."""

    def __init__(
        self,
        sensors: Sequence[SceneSensor],
        settings: RaySensor,
        roster: SceneRoster,
        topics: SensorTopics,
        scene: SensedScene,
    ) -> None:
        """Prepare the messages; see `SensorGroup`."""
        super().__init__(sensors, roster, topics)
        self._settings, self._scene = settings, scene
        self._noise: dict[int, tuple[bytes, SensorNoise]] = {}
        """Noise of blocks of rows, by their first row."""
        rays = settings.horizontal.count * settings.vertical.count
        self._block = max(1, RAYS_AT_ONCE // max(rays, 1))
        self._writers = {
            name: SCAN_WRITERS[name](settings, self._frames, self._compat)
            for name in self._topics.names
            if name in SCAN_WRITERS
        }

    def publish(self, moment: SceneMoment) -> IntArray:
        """See `SensorGroup`."""
        wanted, rows_of = self._topics.find_all_wanted()
        if not len(wanted):
            return wanted
        poses = self._places.find_poses(moment.base, moment.joint_positions)
        for start in range(0, len(wanted), self._block):
            block = wanted[start : start + self._block]
            ranges = self._measure(moment, block, poses[block])
            for name, writer in self._writers.items():
                rows = np.intersect1d(rows_of[name], block, assume_unique=True)
                if len(rows):
                    found = ranges[np.searchsorted(block, rows)]
                    self._topics.put(name, rows, writer.write(rows, moment.time_ns, found))
        return wanted

    def _measure(self, moment: SceneMoment, rows: IntArray, poses: FloatArray) -> FloatArray:
        """Measure ranges (m, vertical, horizontal) of the sensors of some rows at poses (m, 7)."""
        settings = self._settings
        caster = self._scene.find_caster(moment)
        exact = caster.cast(settings, poses, self._places.entities[rows])
        noisy = self._find_noise(rows).apply_to_ranges(
            limit_ranges(exact, settings),
            moment.step,
            range_min_m=settings.range_min_m,
            range_max_m=settings.range_max_m,
        )
        return noisy.reshape(len(rows), settings.vertical.count, settings.horizontal.count)

    def _find_noise(self, rows: IntArray) -> SensorNoise:
        """Find the noise of some rows, which are mostly the same as the last time."""
        first, key = int(rows[0]), rows.tobytes()
        if first not in self._noise or self._noise[first][0] != key:
            self._noise[first] = key, self._make_noise(self._settings.noise, rows.tolist())
        return self._noise[first][1]


def _in_frames(template: msgspec.Struct, frames: Sequence[str]) -> list[msgspec.Struct]:
    return [msgspec.structs.replace(template, header=Header(frame_id=frame)) for frame in frames]


def _find_points(directions: FloatArray, ranges: FloatArray) -> list[FloatArray]:
    """Find the finite points (p, 3) of each row in the sensor's axes."""
    flat = ranges.reshape(len(ranges), -1)
    points = []
    for row in flat:
        is_finite = np.isfinite(row)
        points.append(directions[is_finite] * row[is_finite, None])
    return points


def _add_intensity(points: FloatArray, intensity: float) -> FloatArray:
    table = np.full((len(points), POINT_STEP // 4), intensity, dtype="<f4")
    table[:, :3] = points
    return table
