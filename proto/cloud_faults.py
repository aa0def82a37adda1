"""Faults of point clouds: ranges of points with noise or a bias, and points in a blind sector."""

from collections.abc import Callable

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.fault_messages import TopicFault
from zensim.proto.messages.standard_messages import Point32, PointCloud, PointCloud2

FloatArray = npt.NDArray[np.float64]


def change_points(
    cloud: PointCloud | PointCloud2, fault: TopicFault, change: Callable[[float], float]
) -> PointCloud | PointCloud2:
    """Change the points that a lidar has measured.

    Args:
        cloud: The coordinates of a point of a PointCloud2 are its first three numbers.
        fault: A `sensor_noise`, `sensor_bias` or `sensor_sector`.
        change: Changes a range [m].
    """
    if isinstance(cloud, PointCloud):
        found = np.array([(one.x, one.y, one.z) for one in cloud.points]).reshape(-1, 3)
        kept = _change(found, fault, change)
        points = tuple(Point32(*point) for point in found[kept].tolist())
        return msgspec.structs.replace(cloud, points=points)
    rows = np.frombuffer(cloud.data, np.uint8).reshape(-1, cloud.point_step).copy()
    places = np.ndarray((len(rows), 3), "<f4", rows, strides=(cloud.point_step, 4))
    found = places.astype(np.float64)
    kept = _change(found, fault, change)
    if not cloud.is_dense:  # else it has no place for points without a hit
        with np.errstate(invalid="ignore"):  # along an axis
            found[~kept] *= np.inf
    places[:] = found
    data = (rows[kept] if cloud.is_dense else rows).tobytes()
    row_step = len(data) // max(1, cloud.height)
    width = row_step // cloud.point_step
    return msgspec.structs.replace(cloud, width=width, row_step=row_step, data=data)


def _change(
    points: FloatArray, fault: TopicFault, change: Callable[[float], float]
) -> npt.NDArray[np.bool_]:
    """Change points (n, 3) in place, or find those (n,) that are not in the blind sector."""
    if fault.kind == "sensor_sector":
        angles = np.arctan2(points[:, 1], points[:, 0]).tolist()
        return np.array([not fault.has_angle(angle) for angle in angles], np.bool_)
    ranges = np.sqrt((points * points).sum(axis=1))
    is_hit = np.isfinite(ranges) & (ranges > 0.0)
    changed = np.array([change(one) for one in ranges[is_hit].tolist()])
    points[is_hit] *= (changed / ranges[is_hit])[:, None]
    return np.ones(len(points), np.bool_)
