"""Robots explore a maze by their lidars alone; a map from their scans is that of the maze."""

import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt
import pytest
import small_gicp
from rosbags.typesys import Stores, get_typestore

from tests.integration.processes import eventually, read_json_line, running
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.spawner.client.sim_client import SimClient

FloatArray = npt.NDArray[np.float64]

ROOT = Path(__file__).parents[2]
EXAMPLE = ROOT / "examples" / "explore.py"
MAZE = ROOT / "sim_server" / "worlds" / "maze.sdf"
ROBOTS, SECONDS = 5, 25.0
CHASSIS_M = 0.1
"""From the middle of a robot to its farthest corner, and 3 cm."""
NOISE_M = 0.01

pytestmark = pytest.mark.long_form
TYPES = get_typestore(Stores.ROS2_HUMBLE)


@dataclass(frozen=True)
class Recorded:
    """What one run showed."""

    nearest_m: dict[str, float]
    scans: dict[str, list[tuple[float, FloatArray]]]
    """Of each robot: time [s] and points (n, 2) in the lidar's frame."""
    odometry: dict[str, FloatArray]
    """Of each robot: rows of time, x, y, heading in the world."""


def read_scan(payload: bytes) -> tuple[float, FloatArray]:
    scan: Any = TYPES.deserialize_cdr(payload, "sensor_msgs/msg/LaserScan")
    ranges = np.asarray(scan.ranges, np.float64)
    angles = scan.angle_min + scan.angle_increment * np.arange(len(ranges))
    seen = np.isfinite(ranges)
    points = ranges[seen, None] * np.stack([np.cos(angles[seen]), np.sin(angles[seen])], axis=1)
    return to_seconds(scan.header.stamp), points


def read_odometry(payload: bytes) -> tuple[float, float, float, float]:
    odometry: Any = TYPES.deserialize_cdr(payload, "nav_msgs/msg/Odometry")
    place, turned = odometry.pose.pose.position, odometry.pose.pose.orientation
    heading = 2.0 * np.arctan2(turned.z, turned.w)
    return to_seconds(odometry.header.stamp), place.x, place.y, heading


def to_seconds(stamp: Any) -> float:  # noqa: ANN401
    return float(stamp.sec + stamp.nanosec * 1e-9)


def explore() -> Recorded:
    given = ("--world", "maze", "--model", "box_bot_lidar", "--robots", str(ROBOTS), "--lockstep")
    # Half as fast as time: the program also keeps up with the scans on a machine with other load.
    alike = ("--rtf", "0.5", "--no-viewer", "--json", "--listen", "tcp/127.0.0.1:0")
    with running("up", *given, *alike) as up:
        endpoint = str(read_json_line(up)["endpoint"])
        with open_bus(BusConfig(connect=(endpoint,))) as bus:
            eventually(lambda: len(SimClient(bus).entities()) >= ROBOTS, 60.0, "spawning")
            scans, odometry = bus.subscribe("*/scan", 100_000), bus.subscribe("*/odom", 1_000_000)
            done = subprocess.run(
                [sys.executable, str(EXAMPLE), endpoint, f"{SECONDS:g}"],
                capture_output=True,
                text=True,
                timeout=600,
                check=True,
            )
            heard = scans.take(), odometry.take()
    nearest = dict(line.split(": nearest ") for line in done.stdout.splitlines())
    found = Recorded({name: float(text.split()[0]) for name, text in nearest.items()}, {}, {})
    rows: dict[str, list[tuple[float, ...]]] = {}
    for sample in heard[0]:
        name = sample.key.partition("/")[0]
        found.scans.setdefault(name, []).append(read_scan(sample.payload))
    for sample in heard[1]:
        rows.setdefault(sample.key.partition("/")[0], []).append(read_odometry(sample.payload))
    found.odometry.update({name: np.array(row) for name, row in rows.items()})
    return found


def test_robots_explore_without_a_touch_or_a_lost_scan_and_see_the_maze() -> None:
    # One test, so that workers that share the tests do not explore several times.
    recorded = explore()

    check_motion(recorded)
    check_scans(recorded)
    check_map(recorded)


def check_motion(recorded: Recorded) -> None:
    """Check that all robots explore, and none touches anything."""
    assert len(recorded.nearest_m) == ROBOTS
    assert min(recorded.nearest_m.values()) > CHASSIS_M
    for rows in recorded.odometry.values():
        assert np.hypot(*np.diff(rows[:, 1:3], axis=0).T).sum() > SECONDS * 0.08
        assert np.ptp(rows[:, 0]) > SECONDS


def check_scans(recorded: Recorded) -> None:
    """Check that no scan is lost in lockstep."""
    for scans in recorded.scans.values():
        times = np.array([time_s for time_s, _ in scans])
        assert np.diff(times) == pytest.approx(0.1, abs=1e-6)
        assert len(times) > SECONDS * 10.0


def check_map(recorded: Recorded) -> None:
    """Check that a map from the scans of one robot is that of the maze."""
    robot = "box_bot_lidar0"
    times = np.array([time_s for time_s, _ in recorded.scans[robot]])
    rows = recorded.odometry[robot]
    true = np.stack([np.interp(times, rows[:, 0], rows[:, column]) for column in (1, 2)], axis=1)
    heading = np.interp(times, rows[:, 0], np.unwrap(rows[:, 3]))
    inside = (times >= rows[0, 0]) & (times <= rows[-1, 0])
    start = int(np.flatnonzero(inside)[0])

    poses = match_scans([points for _, points in recorded.scans[robot][start:]])

    first = make_transform(true[start, 0], true[start, 1], heading[start])
    found = np.array([(first @ pose)[:2, 3] for pose in poses])
    off_m = np.hypot(*(found - true[start:])[inside[start:]].T)
    assert np.sqrt(np.mean(off_m**2)) < 0.05
    assert count_hits_of_walls(recorded, robot, start, [first @ pose for pose in poses]) > 0.995


def make_transform(x: float, y: float, heading: float) -> FloatArray:
    transform = np.eye(4)
    transform[:2, :2] = [[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]]
    transform[:2, 3] = x, y
    return transform


def match_scans(scans: list[FloatArray]) -> list[FloatArray]:
    """Find the pose of each scan in the first by matching it with the scans before, by GICP."""
    pose = step = np.eye(4)
    poses, map_, kept = [pose], extrude(scans[0]), pose
    for points in scans[1:]:
        cloud, before, pose = extrude(points), pose, pose @ step
        for within_m, grain_m in ((0.6, 0.08), (0.15, 0.04)):
            pose = small_gicp.align(
                map_[-MAP_POINTS:],
                cloud,
                init_T_target_source=pose,
                downsampling_resolution=grain_m,
                max_correspondence_distance=within_m,
            ).T_target_source
        step = np.linalg.inv(before) @ pose
        poses.append(pose)
        moved = np.linalg.inv(kept) @ pose
        if np.hypot(*moved[:2, 3]) > 0.2 or abs(np.arctan2(moved[1, 0], moved[0, 0])) > 0.3:
            map_, kept = np.concatenate([map_, cloud @ pose[:3, :3].T + pose[:3, 3]]), pose
    return poses


MAP_POINTS = 12_000


def extrude(points: FloatArray) -> FloatArray:
    """Make a cloud (3 n, 3) of points in a plane: normals of surfaces need some height."""
    return np.concatenate(
        [np.column_stack([points, np.full(len(points), z)]) for z in (-0.05, 0.0, 0.05)]
    )


def count_hits_of_walls(
    recorded: Recorded, robot: str, start: int, poses: list[FloatArray]
) -> float:
    """Find the share of points within 3 sigma and 2 cm of a wall, of those that are not robots."""
    low, high = read_walls()
    good = total = 0
    for (time_s, points), pose in zip(recorded.scans[robot][start:], poses, strict=True):
        hits = points @ pose[:2, :2].T + pose[:2, 3]
        robots = np.array([place_at(rows, time_s) for rows in recorded.odometry.values()])
        is_wall = np.linalg.norm(hits[:, None] - robots, axis=2).min(axis=1) > 0.25
        gap = np.maximum(np.maximum(low - hits[:, None], hits[:, None] - high), 0.0)
        inside = np.minimum(hits[:, None] - low, high - hits[:, None]).min(axis=2)
        off = np.where(inside > 0.0, inside, np.linalg.norm(gap, axis=2)).min(axis=1)
        good += int((off[is_wall] <= 3.0 * NOISE_M + 0.02).sum())
        total += int(is_wall.sum())
    return good / total


def place_at(rows: FloatArray, time_s: float) -> tuple[float, float]:
    x, y = (float(np.interp(time_s, rows[:, 0], rows[:, column])) for column in (1, 2))
    return x, y


def read_walls() -> tuple[FloatArray, FloatArray]:
    """Read the boxes of the world file, which are level and along the axes: corners (n, 2)."""
    low, high = [], []
    for collision in ElementTree.parse(MAZE).iter("collision"):
        size = collision.findtext("geometry/box/size")
        place = collision.findtext("pose")
        if size is None or place is None:
            continue
        middle = np.array(place.split()[:2], np.float64)
        half = np.array(size.split()[:2], np.float64) / 2.0
        low.append(middle - half)
        high.append(middle + half)
    return np.array(low), np.array(high)
