"""Faults of bodies, in numbers, in both engines: each robot of one run has another one."""

from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

import zensim
from zensim.proto.messages.gazebo_messages import GetJointPropertiesRequest
from zensim.proto.service_catalog import GET_JOINT_PROPERTIES
from zensim.scenario.scenario_runner import find_end

FloatArray = npt.NDArray[np.float64]
FAULTS = {
    "slip": [
        ("slip1", "wheel_slip", "joint: left_wheel_joint, factor: 0"),
        ("slip2", "wheel_slip", "joint: right_wheel_joint, factor: 0"),
    ],
    "jam": [("jam1", "wheel_jam", "joint: left_wheel_joint")],
    "lock": [("lock1", "joint_lock", "joint: right_wheel_joint")],
    "weak": [
        ("weak1", "motor_weak", "joint: left_wheel_joint, factor: 0"),
        ("weak2", "motor_weak", "joint: right_wheel_joint, factor: 0"),
    ],
    "broken": [("broken1", "link_broken", "link: left_wheel")],
}
ROBOTS = ("quiet", *FAULTS)
TEXT = (
    "zensim: 1\nrobots:\n"
    + "".join(
        f"  - {{name: {name}, model: box_bot, poses: [{{x: 0, y: {3 * row}}}]}}\n"
        for row, name in enumerate(ROBOTS)
    )
    + "behaviours:\n"
    "  - {name: all, robots: '*', do: drive, v: 0.3}\n"
    "  - {name: halt, robots: [slip, quiet], at: 1, for: 1, do: stand}\n"
    "  - {name: wait, robots: weak, for: 1, do: stand}\n"
    "faults:\n"
    + "".join(
        f"  - {{name: {name}, at: 1, for: 1, robots: {robot}, do: {kind}, {keys}}}\n"
        for robot, faults in FAULTS.items()
        for name, kind, keys in faults
    )
    + "end: {at: 4}\n"
)


COLUMNS = ("x", "y", "z", "heading", "speed", "left", "right")


def read_wheels(world: zensim.World, robot: str) -> list[float]:
    requests = [
        GetJointPropertiesRequest(f"{robot}::{side}_wheel_joint") for side in ("left", "right")
    ]
    return [world.call(GET_JOINT_PROPERTIES, one).position[0] for one in requests]


class Track:
    """What one run did, by control steps."""

    def __init__(self, engine: str, file: Path) -> None:
        file.write_text(TEXT)
        rows: list[FloatArray] = []
        times: list[float] = []
        with zensim.World(engine=engine) as world, zensim.load(file, sim=world) as run:
            for _ in world.steps(seconds=find_end(run.scenario)):
                state = run.step()
                joints = np.array([read_wheels(world, name) for name in ROBOTS])
                parts = [run.fleet.poses()[:, :3], state.poses[:, 2:], state.twists[:, :1], joints]
                rows.append(np.hstack(parts))
                times.append(state.now)
        self.times, self.rows = np.array(times), np.array(rows)
        self.events = [(round(one.time, 2), one.name, one.kind) for one in run.events]

    def at(self, time: float, robot: str, column: str) -> float:
        step = int(np.argmin(np.abs(self.times - time)))
        return float(self.rows[step, ROBOTS.index(robot), COLUMNS.index(column)])

    def change(self, start: float, end: float, robot: str, column: str) -> float:
        return self.at(end, robot, column) - self.at(start, robot, column)


@pytest.fixture(scope="module", params=["mujoco", "pybullet"])
def track(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Track:
    return Track(request.param, tmp_path_factory.mktemp("run") / "a.scenario.yaml")


def test_robot_on_slippery_wheels_slides_on(track: Track) -> None:
    assert track.at(1.9, "quiet", "speed") == pytest.approx(0.0, abs=0.01)
    assert track.at(1.9, "slip", "speed") > 0.25


@pytest.mark.parametrize(("robot", "wheel"), [("jam", "left"), ("lock", "right")])
def test_locked_wheel_stays_and_the_robot_turns(track: Track, robot: str, wheel: str) -> None:
    assert abs(track.change(1.1, 1.9, robot, wheel)) < 0.005
    assert abs(track.change(1.1, 1.4, robot, "heading")) > 0.5


def test_motor_without_torque_does_not_start(track: Track) -> None:
    assert abs(track.at(1.9, "weak", "speed")) < 0.02


def test_robot_without_a_wheel_drops_and_stops(track: Track) -> None:
    assert track.change(0.9, 1.9, "broken", "z") < -0.0005
    assert abs(track.at(1.9, "broken", "speed")) < 0.05


@pytest.mark.parametrize("robot", list(FAULTS))
def test_fault_ends_by_itself(track: Track, robot: str) -> None:
    assert track.at(3.9, robot, "speed") == pytest.approx(0.3, abs=0.02)
    assert track.at(3.9, robot, "z") == pytest.approx(track.at(0.9, robot, "z"), abs=1e-4)


def test_each_fault_has_its_two_events(track: Track) -> None:
    names = sorted(name for faults in FAULTS.values() for name, _, _ in faults)

    for time, kind in ((1.0, "start"), (2.0, "end")):
        found = sorted(name for at, name, one in track.events if (at, one) == (time, kind))
        assert [name for name in found if name in names] == names
