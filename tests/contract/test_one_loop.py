"""Runs have equal states and equal bytes in a world in process and on a server in lockstep.

Left out: `thousand`, for its time; topics of the world, which a server publishes by wall time;
odometry of robots that are divided among other pools, because numpy's sine depends on the length of
arrays in its last bit; lidars, whose process may not have started.
"""

from collections.abc import Mapping
from pathlib import Path

import pytest

import zensim
from tests.contract.repository import ROOT
from tests.scenario.scenario_runs import run_alone
from zensim.api.simulation import Simulation
from zensim.deploy.scenario_process import RunRequest
from zensim.proto.messages.standard_messages import JointState
from zensim.recording.recording_reader import RecordingReader
from zensim.scenario.scenario_reader import find_scenario_file

SCENARIOS = {
    "faulty_fleet": (("end.at=0.3 s", "engine.use=mujoco"), {"bumper_states", "imu", "tf"}),
    "first_minutes": (("end.at=0.3 s", "engine.use=mujoco"), {"imu", "tf"}),
    "formation": (("end.at=0.3 s", "engine.use=mujoco"), {"imu", "tf"}),
    "warehouse": (("end.at=0.2 s",), {"bumper_states", "imu", "joint_states", "odom", "tf"}),
}
"""Settings of shipped scenarios, and topics of robots that have equal bytes."""
ARM = ROOT / "examples" / "arm" / "arm_bot.urdf"
ROBOT_CHUNKS = 3
"""Parts of `/robot/topic`, split at slashes."""
FEWEST_COMMON = 5
"""Messages of a topic that both recordings have; that of a server begins when Zenoh has matched."""
Messages = Mapping[str, Mapping[int, bytes]]


def run(name: str, folder: Path, *, is_served: bool) -> tuple[str, Messages]:
    """Run a scenario; return the hash of its last state, and messages by topic and log time."""
    settings, topics = SCENARIOS[name]
    file = folder / f"{is_served}.mcap"
    recorded = (*settings, f"record.to={file}")
    report = run_alone(RunRequest(find_scenario_file(name), recorded, is_served=is_served))
    assert report.error == ""
    found: dict[str, dict[int, bytes]] = {}
    for topic, time_ns, _, payload in RecordingReader(file).messages():
        parts = topic.name.split("/")
        if len(parts) == ROBOT_CHUNKS and parts[-1] in topics:
            found.setdefault(topic.name, {})[time_ns] = payload
    return report.state_hash, found


@pytest.mark.parametrize("name", SCENARIOS)
def test_states_and_topics_of_robots_are_those_of_a_server(name: str, tmp_path: Path) -> None:
    here_hash, here = run(name, tmp_path, is_served=False)
    there_hash, there = run(name, tmp_path, is_served=True)

    assert here_hash == there_hash
    assert here.keys() == there.keys()
    for topic, messages in here.items():
        begin = max(min(messages), min(there[topic]))
        common = {time: payload for time, payload in messages.items() if time >= begin}
        assert len(common) >= FEWEST_COMMON, topic
        assert common == {t: data for t, data in there[topic].items() if t >= begin}, topic


def move_arm(sim: Simulation) -> str:
    """Command an arm before the first step and later, with a robot that comes between."""
    with sim:
        topic = sim.spawn(str(ARM), name="arm").topic("joint_commands")
        topic.put(JointState(name=("shoulder",), position=(0.5,)))
        sim.step(2)
        sim.spawn("box_bot", name="box", x=3.0).drive(0.3)
        sim.step(10)
        topic.put(JointState(name=("shoulder",), position=(-0.5,)))
        sim.step(30)
        return sim.state_hash()


def test_joints_obey_messages_alike() -> None:
    here = move_arm(zensim.World(engine="mujoco"))

    assert [move_arm(zensim.launch(engine="mujoco")) for _ in range(2)] == [here, here]
