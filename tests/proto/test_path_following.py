"""Controller that drives a robot along points."""

import math

import pytest

from zensim.proto.path_following import MAX_TURN, REACHED_M, PathController

PERIOD_S = 0.05


def drive(points: list[tuple[float, float]], speed: float) -> list[tuple[float, float, float]]:
    """Drive an ideal robot from the origin along points; return its poses."""
    path, poses = PathController(points, speed), [(0.0, 0.0, 0.0)]
    while (command := path.control(*poses[-1])) is not None and len(poses) < 10_000:
        (x, y, yaw), (forward, turn) = poses[-1], command
        assert 0.0 <= forward <= speed
        assert abs(turn) <= MAX_TURN
        x, y = x + forward * PERIOD_S * math.cos(yaw), y + forward * PERIOD_S * math.sin(yaw)
        poses.append((x, y, yaw + turn * PERIOD_S))
    return poses


@pytest.mark.parametrize("goal", [(2.0, 0.0), (0.0, 2.0), (-2.0, 0.1), (1.0, -1.0)])
def test_path_ends_at_its_last_point(goal: tuple[float, float]) -> None:
    x, y, _ = drive([goal], 0.5)[-1]

    assert math.dist((x, y), goal) < REACHED_M


def test_path_passes_each_point_in_turn() -> None:
    points = [(1.0, 0.0), (1.0, 1.0), (0.0, 1.0)]

    poses = drive(points, 0.4)

    nearest = [min(range(len(poses)), key=lambda i: math.dist(poses[i][:2], p)) for p in points]
    assert nearest == sorted(nearest)
    assert all(math.dist(poses[i][:2], p) < 0.06 for i, p in zip(nearest, points, strict=True))


def test_path_without_points_is_over() -> None:
    assert PathController([], 1.0).control(0.0, 0.0, 0.0) is None
