"""What slam_toolbox, AMCL and costmaps make of a LaserScan, as pure functions.

Rules from slam_toolbox 2.6 (laser_utils, karto), nav2_amcl and nav2_costmap_2d with laser_geometry.
"""

import math

import numpy as np

from zensim.proto.messages.standard_messages import LaserScan
from zensim.proto.se3 import FloatArray

FLOAT_EPSILON = float(np.finfo(np.float32).eps)
NEARLY_FULL_RAD = 6.10865
"""350 degrees: from there slam_toolbox tolerates a first and last ray in one direction."""


def count_expected_readings(scan: LaserScan) -> int:
    """Count the readings that slam_toolbox expects; it discards scans with another count."""
    sweep = abs(scan.angle_max - scan.angle_min)
    steps = round(sweep / scan.angle_increment)
    slack = scan.angle_increment - FLOAT_EPSILON * 2.0 * math.pi
    is_full = abs(sweep - 2.0 * math.pi) < slack
    if sweep > NEARLY_FULL_RAD and steps + 1 == len(scan.ranges):
        is_full = False
    return steps if is_full else steps + 1


def find_amcl_hits(scan: LaserScan) -> FloatArray:
    """Find the ranges that AMCL's likelihood field uses, by ray; NaN for the others."""
    ranges = np.array(scan.ranges)
    shown = np.where(ranges <= scan.range_min, scan.range_max, ranges)
    return np.where(shown < scan.range_max, shown, np.nan)


def find_costmap_marks(scan: LaserScan) -> FloatArray:
    """Find the ranges that costmaps mark and clear up to, by ray; NaN for the others."""
    ranges = np.array(scan.ranges)
    is_used = (ranges >= scan.range_min) & (ranges < scan.range_max)
    return np.where(is_used, ranges, np.nan)


def find_costmap_clearings(scan: LaserScan) -> FloatArray:
    """Find the ranges that costmaps with `inf_is_valid` clear up to, by ray."""
    ranges = np.array(scan.ranges)
    far = float(np.nextafter(np.float32(scan.range_max), np.float32(0.0)))
    marks: FloatArray = np.where(ranges == np.inf, far, find_costmap_marks(scan))
    return marks


def find_ray_angles(scan: LaserScan) -> FloatArray:
    """Find the directions of the rays [rad], as every consumer does."""
    return np.asarray(scan.angle_min + scan.angle_increment * np.arange(len(scan.ranges)))
