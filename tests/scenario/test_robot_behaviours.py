"""Behaviours drive robots of a kinematic model on arrays."""

from pathlib import Path

import numpy as np
import pytest

from zensim.proto.se3 import FloatArray
from zensim.scenario.robot_behaviours import FleetState, PythonController, load_class, make_motions
from zensim.scenario.scenario_format import PythonBehaviour
from zensim.scenario.scenario_nodes import ScenarioInvalid
from zensim.scenario.scenario_reader import read_scenario

PERIOD = 0.02
ROBOTS = "zensim: 1\nrobots:\n  - {name: r, model: box_bot, count: 3, layout: {spacing: 5 m}}\n"


def no_controller(behaviour: PythonBehaviour, _names: object) -> PythonController:
    raise AssertionError(behaviour.call)


DISC = (2.0, 0.1, 0.4)
"""x, y and radius [m] of an obstacle ahead of the first robot."""


def cast_at_discs(origins: FloatArray, along: FloatArray, range_max: float) -> FloatArray:
    """Cast rays at one disc."""
    offset = np.array(DISC[:2]) - origins[:, :2]
    ahead = (offset * along[:, :2]).sum(axis=1)
    squared = (offset**2).sum(axis=1) - ahead**2
    depth = np.sqrt(np.maximum(DISC[2] ** 2 - squared, 0.0))
    found = ahead - depth
    is_hit = (squared < DISC[2] ** 2) & (found > 0.0) & (found < range_max)
    return np.where(is_hit, found, np.inf)


def drive(folder: Path, behaviour: str, seconds: float) -> FloatArray:
    """Drive three robots at x = 0, 5, 10; the track of x, y, heading is (steps, 3, 3)."""
    file = folder / "b.scenario.yaml"
    file.write_text(f"{ROBOTS}behaviours:\n  - {behaviour}\n")
    motions = make_motions(read_scenario(str(file)), no_controller, cast_at_discs)
    poses = np.array([[0.0, 0.0, 0.0], [5.0, 0.0, 0.0], [10.0, 0.0, 0.0]])
    track = []
    for step in range(round(seconds / PERIOD)):
        track.append(poses.copy())
        state = FleetState(step * PERIOD, PERIOD, poses.copy(), np.zeros((3, 6)))
        for one in motions:
            if one.is_active(state.now):
                twists = one.motion.command(state)
                heading = poses[one.rows, 2]
                poses[one.rows, 0] += twists[:, 0] * np.cos(heading) * PERIOD
                poses[one.rows, 1] += twists[:, 0] * np.sin(heading) * PERIOD
                poses[one.rows, 2] += twists[:, 1] * PERIOD
    return np.array(track)


def test_stand_does_not_move(tmp_path: Path) -> None:
    track = drive(tmp_path, "{name: b, robots: r*, do: stand}", 1.0)

    assert (track == track[0]).all()


def test_drive_goes_at_its_speed_in_its_time(tmp_path: Path) -> None:
    track = drive(tmp_path, "{name: b, robots: r1, do: drive, v: 0.5, at: 1, for: 2}", 5.0)

    assert track[:51, 1, 0] == pytest.approx(5.0)
    assert track[-1, 1, 0] == pytest.approx(6.0)
    assert (track[:, 0] == track[0, 0]).all()


@pytest.mark.parametrize("radius", [0.5, -0.5])
def test_circle_has_its_radius(radius: float, tmp_path: Path) -> None:
    track = drive(tmp_path, f"{{name: b, robots: r0, do: circle, speed: 0.4, radius: {radius}}}", 8)

    distance = np.hypot(track[:, 0, 0], track[:, 0, 1] - radius)
    assert distance == pytest.approx(0.5, abs=0.02)


def test_waypoints_are_reached_in_order_and_the_robot_stops(tmp_path: Path) -> None:
    way = "{name: b, robots: r0, do: waypoints, points: [[1, 0], [1, 1]], speed: 0.5}"

    track = drive(tmp_path, way, 14.0)

    first = np.argmin(np.hypot(track[:, 0, 0] - 1.0, track[:, 0, 1]))
    second = np.argmin(np.hypot(track[:, 0, 0] - 1.0, track[:, 0, 1] - 1.0))
    assert 0 < first < second
    assert track[-1, 0, :2] == pytest.approx((1.0, 1.0), abs=0.11)
    assert track[-1, 0] == pytest.approx(track[-50, 0])


def test_loop_begins_again(tmp_path: Path) -> None:
    way = "{name: b, robots: r0, do: waypoints, points: [[1, 0], [0, 0]], speed: 0.5, loop: true}"

    track = drive(tmp_path, way, 30.0)

    assert np.count_nonzero(np.diff(np.sign(track[:, 0, 0] - 0.5))) > 4


def test_patrol_returns_and_pauses_at_the_ends(tmp_path: Path) -> None:
    way = "{name: b, robots: r0, do: patrol, points: [[0, 0], [1, 0]], speed: 0.5, pause: 2 s}"

    track = drive(tmp_path, way, 40.0)

    x = track[:, 0, 0]
    still = np.all(track[1:, 0] == track[:-1, 0], axis=1)
    assert x.max() == pytest.approx(1.0, abs=0.15)
    assert x[-1000:].min() < 0.3
    assert np.count_nonzero(still) * PERIOD > 4.0


def test_random_walk_turns_at_its_times_only(tmp_path: Path) -> None:
    walk = "{name: b, robots: r*, do: random_walk, speed: 0.3, turn: 1.0, turn_every: 1 s}"

    track = drive(tmp_path, walk, 4.0)

    rates = np.diff(track[:, :, 2], axis=0) / PERIOD
    changes = np.abs(np.diff(rates, axis=0)) > 1e-6
    assert np.abs(rates).max() <= 1.0
    assert sorted({*np.flatnonzero(changes.any(axis=1)).tolist()}) == [49, 99, 149]
    assert len({*rates[0].tolist()}) == 3


def test_follower_keeps_its_distance(tmp_path: Path) -> None:
    follow = "{name: b, robots: r1, do: follow, target: r0, distance: 1.5, speed: 1}"

    track = drive(tmp_path, follow, 20.0)

    assert track[-1, 1, 0] == pytest.approx(1.5, abs=0.05)


def test_python_class_is_found_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "my_own_team.py").write_text("class Control:\n    pass\n")

    assert load_class("my_own_team:Control", tmp_path).__name__ == "Control"


@pytest.mark.parametrize("call", ["no_such_module:X", "math:NoSuchClass"])
def test_missing_python_class_is_named(call: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=call.partition(":")[0]):
        load_class(call, tmp_path)


def test_robot_navigates_around_what_rays_hit(tmp_path: Path) -> None:
    track = drive(
        tmp_path, "{name: b, robots: r0, do: navigate, points: [[4, 0], [0, 0]], speed: 0.5}", 25.0
    )

    gaps = np.hypot(track[:, 0, 0] - DISC[0], track[:, 0, 1] - DISC[1]) - DISC[2]
    assert gaps.min() > 0.25
    assert np.hypot(track[:, 0, 0] - 4.0, track[:, 0, 1]).min() < 0.45


def test_recorded_commands_are_repeated(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("time,robot,v,w\n0.5,r0,0.4,0\n1.5,r0,0,0\n0,r1,0.1,0\n")

    track = drive(tmp_path, "{name: b, robots: 'r[0-1]', do: replay, file: run.csv, at: 1}", 4.0)

    assert track[-1, :2, 0] == pytest.approx([0.4, 5.3], abs=0.02)
    assert track[round(1.4 / PERIOD), 0, 0] == 0.0


def test_recorded_commands_loop(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("time,v,w\n0,0.4,0\n0.5,0,0\n1,0,0\n")

    track = drive(tmp_path, "{name: b, robots: r0, do: replay, file: run.csv, loop: true}", 3.0)

    assert track[-1, 0, 0] == pytest.approx(0.6, abs=0.02)


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("t,v\n", "line 1"),
        ("time,v,w\n0,x,0\n", "line 2"),
        ("time,v,w\n0,1,0\n0,1,0\n", "line 3"),
        ("time,robot,v,w\n0,nobody,1,0\n", "line 2"),
    ],
)
def test_broken_recording_is_a_mistake_of_the_file(text: str, line: str, tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text(text)

    with pytest.raises(ScenarioInvalid, match=line):
        drive(tmp_path, "{name: b, robots: r0, do: replay, file: run.csv}", 1.0)
