"""All vehicles of a world, moved as they are commanded, without a network."""

import math
from itertools import pairwise

import numpy as np
import pytest

from tests.zensim.vda5050.orders import action, edge, header, line, node, order, write
from tests.zensim.vda5050.test_vehicle import make
from zensim.proto.messages.vehicle_messages import MAX_ROUTE_POINTS, VehicleStatus
from zensim.proto.se3 import FloatArray
from zensim.vda5050.footprint_check import Box
from zensim.vda5050.path_follower import VehicleLimits
from zensim.vda5050.vehicle import Vehicle, VehiclePose
from zensim.vda5050.vehicle_fleet import VehicleFleet
from zensim.vda5050.vehicle_reports import report_status

DT_S = 0.03


class World:
    """Ideal differential robots that keep the twists of the fleet."""

    def __init__(self, *places: tuple[float, float], avoids: bool = False) -> None:
        self.names = tuple(f"r{at}" for at in range(len(places)))
        self.poses = np.array([(*place, 0.0) for place in places])
        self.twists = np.zeros((len(places), 3))
        self.now_s = 1.0
        self.released: set[str] = set()
        self.fleet = VehicleFleet(avoids=avoids, max_deviation_m=1.0)
        for name in self.names:
            self.add(name)
        self.run(0.1)

    def add(self, name: str) -> Vehicle:
        vehicle = make()
        vehicle.name = name
        self.fleet.add(vehicle, VehicleLimits())
        return vehicle

    def find(self, name: str) -> Vehicle:
        found = self.fleet.find(name)
        assert found is not None
        return found

    def run(self, seconds: float, *, is_blocked: bool = False) -> None:
        for _ in range(round(seconds / DT_S)):
            yaw = self.poses[:, 2]
            v, _, w = self.twists.T * (not is_blocked)
            moved = np.column_stack([v * np.cos(yaw), v * np.sin(yaw), w]) * DT_S
            self.poses, self.now_s = self.poses + moved, self.now_s + DT_S
            names, twists = self.fleet.step(self.names, self._make_base(), self.now_s)
            self.released = set()
            for name, twist in zip(names, twists, strict=True):
                if np.isnan(twist).any():
                    self.released.add(name)
                self.twists[self.names.index(name)] = np.nan_to_num(twist)

    def _make_base(self) -> FloatArray:
        base = np.zeros((len(self.names), 13))
        base[:, :2] = self.poses[:, :2]
        base[:, 5], base[:, 6] = np.sin(self.poses[:, 2] / 2), np.cos(self.poses[:, 2] / 2)
        base[:, 7] = self.twists[:, 0] * np.cos(self.poses[:, 2])
        base[:, 8] = self.twists[:, 0] * np.sin(self.poses[:, 2])
        return base


def send(world: World, name: str, **fields: object) -> None:
    pose = world.fleet.pose(name)
    assert pose is not None
    given = line(pose.position, (pose.x + 2.0, pose.y)) | fields
    world.find(name).take_order(write(given), pose)


def test_vehicles_drive_at_the_same_time_and_are_released() -> None:
    world = World((0, 0), (0, 5), (0, 9))
    send(world, "r0")
    send(world, "r2")

    world.run(6.0)

    assert world.poses[:, 0] == pytest.approx([2.0, 0.0, 2.0], abs=0.05)
    assert world.find("r2").progress.is_idle
    assert not world.twists.any()


def test_vehicle_that_swings_back_drives_until_it_stands() -> None:
    world = World((0, 0))
    send(world, "r0")
    while not world.find("r0").progress.is_idle:
        world.run(DT_S)
    reports = []
    for speed in (0.03, 0.0, -0.03, -0.03, *[0.0] * 10):
        world.twists[0, 0] = speed
        world.run(DT_S)
        motion = world.fleet.motion("r0")
        assert motion is not None
        reports.append(motion.is_driving)

    assert sum(before != after for before, after in pairwise(reports)) == 1
    assert reports[4]
    assert not reports[-1]


def test_contact_before_a_reset_of_time_violates_no_field_for_long() -> None:
    world = World((0, 0))
    world.run(5.0)
    world.fleet.note_contact("r0")
    world.run(0.1)
    touched = world.fleet.motion("r0")
    world.now_s = 0.0
    world.run(1.2)
    later = world.fleet.motion("r0")

    assert touched is not None
    assert touched.is_field_violated
    assert later is not None
    assert not later.is_field_violated


def test_vehicle_waits_at_its_decision_point_and_goes_on() -> None:
    world = World((0, 0))
    pose = world.fleet.pose("r0")
    assert pose is not None
    world.find("r0").take_order(write(line((0, 0), (1, 0), (2, 0), released=2)), pose)

    world.run(5.0)
    waiting = world.poses[0, 0]
    nodes = [node(2, (1, 0)), node(4, (2, 0))]
    world.find("r0").take_order(write(order(nodes, [edge(3)], update=1)), pose)
    world.run(5.0)

    assert waiting == pytest.approx(1.0, abs=0.03)
    assert world.poses[0, 0] == pytest.approx(2.0, abs=0.03)


def test_vehicle_does_not_stop_where_it_needs_not() -> None:
    world = World((0, 0))
    pose = world.fleet.pose("r0")
    assert pose is not None
    nodes = [node(0, (0, 0)), node(2, (2, 0), action("wait", "a", "NONE")), node(4, (4, 0))]
    world.find("r0").take_order(write(order(nodes, [edge(1), edge(3)])), pose)

    speeds = []
    while len(world.find("r0").progress.nodes) == 2:
        world.run(DT_S)
    for _ in range(10):
        world.run(DT_S)
        speeds.append(world.twists[0, 0])

    assert min(speeds) > 0.8


def test_vehicle_that_is_moved_away_stops_with_an_error_until_it_is_back() -> None:
    world = World((0, 0))
    send(world, "r0")
    world.run(1.0)
    world.poses[0, 1] = 3.0
    world.run(0.3)
    errors, stopped = list(world.find("r0").errors), world.twists.any()
    world.poses[0, 1] = 0.0
    world.run(6.0)

    assert [one.kind.type_2 for one in errors] == ["outOfRoute"]
    assert not stopped
    assert world.find("r0").errors == []
    assert world.poses[0, 0] == pytest.approx(2.0, abs=0.05)


def test_vehicle_that_cannot_move_says_so_until_it_does() -> None:
    world = World((0, 0))
    vehicle = world.find("r0")
    send(world, "r0")
    world.run(1.0)
    world.run(4.5, is_blocked=True)
    motion, early = world.fleet.motion("r0"), list(vehicle.errors)
    world.run(1.0, is_blocked=True)
    late, vehicle.needs_state = list(vehicle.errors), False
    world.run(1.0, is_blocked=True)
    assert not vehicle.needs_state
    world.run(0.3)
    assert vehicle.errors == []
    assert summarize(world, "r0").task == "driving"

    assert motion is not None
    assert not motion.is_driving
    assert early == []
    assert [(one.kind.type_2, one.kind.level_2) for one in late] == [("noProgress", "WARNING")]


def test_vehicle_that_has_to_stand_lacks_no_progress() -> None:
    world = World((0, 0), (0, 5), (1.8, 0), avoids=True)
    world.fleet.set_boxes({name: Box() for name in world.names})
    send(world, "r0")
    send(world, "r1")
    world.run(1.0)
    world.find("r1").take_over()

    world.run(9.0)

    assert [one.errors for one in world.fleet] == [[], [], []]


def test_vehicle_stops_before_another_one() -> None:
    world = World((0, 0), (1.8, 0), avoids=True)
    world.fleet.set_boxes({name: Box() for name in world.names})
    send(world, "r0")

    world.run(6.0)
    motion = world.fleet.motion("r0")

    assert 0.7 < world.poses[0, 0] < 1.1
    assert motion is not None
    assert motion.is_field_violated


def test_row_of_a_removed_vehicle_is_used_again() -> None:
    world = World((0, 0), (0, 5))
    send(world, "r0")
    world.run(1.0)
    world.fleet.remove("r0")
    world.twists[0] = 0.0

    before = len(world.fleet.vehicles)
    vehicle = world.add("r0")
    place = world.poses[0].copy()
    world.run(1.0)

    assert len(world.fleet.vehicles) == before
    assert vehicle.progress.is_idle
    assert world.poses[0].tolist() == place.tolist()
    assert math.isfinite(place[0])


def test_reset_of_time_moves_nothing() -> None:
    world = World((0, 0))
    send(world, "r0")
    world.run(1.0)
    world.now_s = 0.0

    world.run(6.0)

    assert world.poses[0, 0] == pytest.approx(2.0, abs=0.05)


def summarize(world: World, name: str) -> VehicleStatus:
    motion = world.fleet.motion(name)
    assert motion is not None
    return report_status(world.find(name), motion, world.fleet.find_route(name))


def read_route(status: VehicleStatus) -> FloatArray:
    return np.frombuffer(status.route, "<f4").reshape(-1, 2).astype(float)


def test_status_has_order_task_and_the_route_that_is_left() -> None:
    world = World((0, 0), (0, 5))
    send(world, "r0")
    world.run(1.5)

    driving, idle = summarize(world, "r0"), summarize(world, "r1")
    route = read_route(driving)

    assert (driving.task, driving.order, bool(driving.goal)) == ("driving", "o1", True)
    assert route[0] == pytest.approx(world.poses[0, :2], abs=0.05)
    assert route[-1] == pytest.approx([2.0, 0.0])
    assert (idle.task, idle.order, idle.goal, idle.route) == ("idle", "", "", b"")


def pause(name: str) -> dict[str, object]:
    return header(2) | {"actions": [action(name, name)]}


def test_status_says_paused_arrived_and_rejected() -> None:
    world = World((0, 0))
    vehicle, pose = world.find("r0"), world.fleet.pose("r0")
    assert pose is not None
    send(world, "r0")
    world.run(1.0)
    vehicle.take_instant_actions(write(pause("startPause")), pose)
    world.run(0.5)
    assert summarize(world, "r0").task == "paused"

    vehicle.take_instant_actions(write(pause("stopPause")), pose)
    world.run(6.0)
    vehicle.take_order(b"{", pose)
    arrived = summarize(world, "r0")

    assert (arrived.task, arrived.goal, arrived.route) == ("idle", "", b"")
    assert len(arrived.errors) == 1


def test_vehicle_that_somebody_takes_over_stops_and_is_released() -> None:
    world = World((0, 0))
    send(world, "r0")
    world.run(1.0)

    world.find("r0").take_over()
    released = set()
    for _ in range(round(2.0 / DT_S)):
        world.run(DT_S)
        released |= world.released
    stood = world.twists[0].copy()
    world.find("r0").take_instant_actions(write(pause("stopPause")), VehiclePose())
    world.run(0.5)

    assert (not stood.any(), released) == (True, {"r0"})
    assert world.twists[0, 0] > 0.1


def test_long_route_is_told_by_few_points() -> None:
    world = World((0, 0))
    pose = world.fleet.pose("r0")
    assert pose is not None
    world.find("r0").take_order(write(line(*[(0.3 * at, 0.0) for at in range(100)])), pose)
    world.run(0.1)

    route = read_route(summarize(world, "r0"))

    assert len(route) == MAX_ROUTE_POINTS
    assert route[-1] == pytest.approx([29.7, 0.0])
