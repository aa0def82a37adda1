"""Path following of all kinds of vehicles in arrays, against ideal motion."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from tests.zensim.vda5050.orders import edge, node, order, write
from zensim.proto.se3 import FloatArray
from zensim.vda5050.path_follower import ACKERMANN, TRICYCLE, RouteTable, VehicleLimits, follow
from zensim.vda5050.route_geometry import Route, make_route, sample_nurbs
from zensim.vda5050.vda_messages import ControlPoint, CurvedEdge, Order, read_message

DT_S = 0.03
DIFFERENTIAL = VehicleLimits()
SIDEWAYS = VehicleLimits(is_sideways=True)
CAR = VehicleLimits(curvature=1.0 / 0.8, steering=ACKERMANN, wheelbase=0.5)
TRICYCLES = VehicleLimits(curvature=1.0 / 0.8, steering=TRICYCLE, wheelbase=0.5)
STEERED = VehicleLimits(curvature=1.0 / 0.8)


def make(places: Sequence[tuple[float, float]], **fields: "str | float | dict[str, Any]") -> Route:
    nodes = [node(2 * at, place) for at, place in enumerate(places)]
    edges = [edge(2 * at + 1) | fields for at in range(len(places) - 1)]
    given = read_message(Order, write(order(nodes, edges)))
    return make_route(places[0], given.nodes[1:], given.edges, max_speed=1.0, deceleration=0.35)


def make_table(limits: Sequence[VehicleLimits], route: Route) -> RouteTable:
    table = RouteTable()
    table.resize(len(limits))
    for row, one in enumerate(limits):
        table.set_limits(row, one)
        table.set_route(row, route, (0.0, 0.0))
    table.stop_s[:] = route.s[-1]
    table.node_s[:] = route.node_s[-1]
    table.stop_heading[:] = math.nan
    return table


def move(limits: VehicleLimits, pose: FloatArray, twist: FloatArray) -> FloatArray:
    """Move an ideal vehicle for a step."""
    v, left, w = twist.tolist()
    if limits.steering == ACKERMANN:
        w = abs(v) * math.tan(w) / limits.wheelbase
    elif limits.steering == TRICYCLE:
        v, w = v * math.cos(w), v * math.sin(w) / limits.wheelbase
    x, y, yaw = pose.tolist()
    x += (v * math.cos(yaw) - left * math.sin(yaw)) * DT_S
    y += (v * math.sin(yaw) + left * math.cos(yaw)) * DT_S
    return np.array([x, y, yaw + w * DT_S])


def drive(
    limits: Sequence[VehicleLimits],
    route: Route,
    *,
    seconds: float = 60.0,
    heading: float = math.nan,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Drive; return final poses, largest distances from the route, and all speeds."""
    table = make_table(limits, route)
    table.stop_heading[:], table.aligned[:] = heading, 0.05
    poses = np.tile(np.array(start), (len(limits), 1))
    worst = np.zeros(len(limits))
    speeds: list[FloatArray] = []
    for _ in range(round(seconds / DT_S)):
        twists, progress = follow(table, poses, DT_S, np.full(len(limits), np.inf))
        poses = np.array([move(*each) for each in zip(limits, poses, twists, strict=True)])
        worst, speeds = np.maximum(worst, progress.off), [*speeds, table.driven.copy()]
        if progress.arrived.all():
            break
    assert progress.arrived.all(), (poses, table.cursor)
    return poses, worst, np.array(speeds)


def test_every_kind_of_vehicle_follows_a_curve_and_stops_at_its_end() -> None:
    points = ({"x": 0, "y": 0}, {"x": 3, "y": 0}, {"x": 3, "y": 3})
    curve = {"degree": 2, "knotVector": [0, 0, 0, 1, 1, 1], "controlPoints": list(points)}

    poses, worst, speeds = drive(
        [DIFFERENTIAL, SIDEWAYS, CAR, TRICYCLES, STEERED], make([(0, 0), (3, 3)], trajectory=curve)
    )

    assert np.hypot(*(poses[:, :2] - [3, 3]).T).max() < 0.06
    assert worst.max() < 0.15
    assert (speeds[-1] < 0.15).all()


@pytest.mark.parametrize("limits", [DIFFERENTIAL, SIDEWAYS], ids=["differential", "sideways"])
def test_vehicle_passes_a_right_angle_on_its_point(limits: VehicleLimits) -> None:
    poses, worst, _ = drive([limits], make([(0, 0), (2, 0), (2, 2), (0, 2)]))

    assert np.hypot(*(poses[0, :2] - [0, 2])) < 0.06
    assert worst.max() < 0.08


def test_speed_rises_and_falls_within_its_limits() -> None:
    _, _, speeds = drive([DIFFERENTIAL], make([(0, 0), (6, 0)]))
    _, _, slow = drive([DIFFERENTIAL], make([(0, 0), (2, 0)], maxSpeed=0.3))

    changes = np.diff(speeds[:, 0]) / DT_S
    assert 0.9 < speeds.max() <= 1.0
    assert slow.max() == pytest.approx(0.3)
    assert changes.max() < 0.51
    assert changes[:-1].min() > -0.9


def test_vehicle_turns_to_the_heading_of_its_stop() -> None:
    poses, _, _ = drive([DIFFERENTIAL, SIDEWAYS], make([(0, 0), (1, 0)]), heading=2.0)

    assert np.abs(poses[:, 2] - 2.0).max() < 0.06


def test_vehicle_drives_backward_or_sideways_where_the_edge_says_so() -> None:
    back, _, _ = drive(
        [DIFFERENTIAL], make([(0, 0), (2, 0)], orientation=math.pi), start=(0, 0, math.pi)
    )
    aside, _, _ = drive(
        [SIDEWAYS], make([(0, 0), (0, 2)], orientation=0.0, orientationType="GLOBAL")
    )

    assert back[0, 0] == pytest.approx(2.0, abs=0.06)
    assert abs(math.remainder(back[0, 2] - math.pi, 2 * math.pi)) < 0.1
    assert aside[0].tolist() == pytest.approx([0.0, 2.0, 0.0], abs=0.06)


def test_gate_stops_a_vehicle_at_once() -> None:
    table = make_table([DIFFERENTIAL] * 2, make([(0, 0), (6, 0)]))
    gate = np.array([0.0, np.inf])

    for _ in range(20):
        twists, _ = follow(table, np.zeros((2, 3)), DT_S, gate)

    assert (twists[0] == 0.0).all()
    assert twists[1, 0] > 0.2


def test_vehicle_without_a_route_stands() -> None:
    table = make_table([DIFFERENTIAL], make([(0, 0), (6, 0)]))
    table.clear_route(0)

    twists, progress = follow(table, np.ones((1, 3)), DT_S, np.full(1, np.inf))

    assert (twists == 0.0).all()
    assert not progress.arrived.any()
    assert not progress.passed.any()


def test_route_in_progress_is_taken_up_where_the_vehicle_is() -> None:
    points = [{"x": 0, "y": 0}, {"x": 10, "y": 0}]
    curve = {"degree": 1, "knotVector": [0, 0, 1, 1], "controlPoints": points}
    route = make([(0, 0), (10, 0)], trajectory=curve)
    table = make_table([DIFFERENTIAL], route)

    table.set_route(0, route, (7.1, 0.1))
    twists, progress = follow(table, np.array([[7.1, 0.1, 0.0]]), DT_S, np.full(1, np.inf))

    assert progress.s[0] == pytest.approx(7.1, abs=0.01)
    assert abs(twists[0, 2]) < 0.5


def test_nurbs_of_a_quarter_circle_is_exact() -> None:
    points = ((1.0, 0.0, 1.0), (1.0, 1.0, math.sqrt(0.5)), (0.0, 1.0, 1.0))
    curve = CurvedEdge(
        tuple(ControlPoint(*one) for one in points), degree=2, knot_vector=(0, 0, 0, 1, 1, 1)
    )

    found = sample_nurbs(curve)

    assert np.hypot(*found.T) == pytest.approx(1.0)
    assert found[0].tolist() == pytest.approx([1.0, 0.0])
    assert found[-1].tolist() == pytest.approx([0.0, 1.0])


def test_nurbs_without_knots_is_clamped() -> None:
    curve = CurvedEdge(tuple(ControlPoint(x, y) for x, y in ((0, 0), (1, 1), (2, 0), (3, 1))))

    found = sample_nurbs(curve)

    assert found[0].tolist() == [0.0, 0.0]
    assert found[-1].tolist() == pytest.approx([3.0, 1.0])
