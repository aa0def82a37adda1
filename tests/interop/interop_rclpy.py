"""rclpy over DDS and a bridge

Processes of rclpy (jazzy, from wheels, over Fast DDS on loopback) and a server with `--ros-bridge`
have zenoh-plugin-ros2dds 1.10.2 between them, the bridge that many users run. Ten robots are
spawned as the script of a tutorial does, one metre apart, by `/gazebo/spawn_entity`: the bridge
takes services of Cyclone DDS only, and no wheel has its rmw, so a client of Cyclone DDS calls them
with the request header that rmw_cyclonedds_cpp writes. Then rclpy finds topics and profiles, drives
with Twist and TwistStamped, follows `/clock`, and answers scans in
[lockstep](time.md#ros-nodes-in-lockstep), at once and late. The bridge, the agent and a node are
killed with SIGKILL. `examples/ros2_check.py` runs beside ten robots of `zensim up`, which is killed
and started again under a node that listens.
"""

import re
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.figures import Figure
from benchmarks.machine import ROOT
from tests.integration.node_runs import WAIT, read_places
from tests.integration.processes import START_S, eventually, free_endpoint, read_json_line, running
from tests.integration.repeatable_run import state_hash
from tests.integration.sensor_runs import read_stats, wait_until_active
from tests.interop.acceptance import all_of, at_most, naming, none_of, within
from tests.interop.ros_processes import (
    BRIDGED,
    DDS_CLIENT,
    PEER,
    RosHost,
    RosNetwork,
    read_line,
    read_ready,
    ros_host,
    running_pool,
    spawn_lidar_robots,
    wait_until_driven,
)
from zensim.sim_server.description import builtin_models

if TYPE_CHECKING:
    import subprocess

ROBOTS = 10
NAMES = [f"box_bot{number}" for number in range(ROBOTS)]
LISTEN_S, LISTEN_SHORT_S = "10", "2"
DRIVE_S = "2"
WAY_M = (0.36, 0.44)
CALL_MS, CLOCK_S, STOPPED_M = 100.0, 0.1, 0.001
STEPS = 480
DELAYS_S = ("0", "0", "0.003", "0.03")
LATCHED, VOLATILE = ["RELIABLE", "TRANSIENT_LOCAL"], ["RELIABLE", "VOLATILE"]
PROFILES = {
    "odom": [*VOLATILE, "nav_msgs/msg/Odometry"],
    "scan": [*VOLATILE, "sensor_msgs/msg/LaserScan"],
    "tf_static": [*LATCHED, "tf2_msgs/msg/TFMessage"],
    "robot_description": [*LATCHED, "std_msgs/msg/String"],
    "map": [*LATCHED, "nav_msgs/msg/OccupancyGrid"],
}
CHECK = ROOT / "examples" / "ros2_check.py"
CHECKS = {
    ("frames",): (rf"frames of {ROBOTS} robots .* ([\d.]+) s$", "all frames under world", "s"),
    ("square", NAMES[0]): (r"closed to ([\d.]+) m", "end of a square to its begin", "m"),
    ("resume", NAMES[0]): (r"again ([\d.]+) s", "kill of the simulator to odometry", "s"),
}
"""Checks of users, with what they print of a figure and its name."""
CHECK_S = 150.0
SERVICES = {
    "/spawn_entity": "simulation_interfaces/srv/SpawnEntity",
    "/gazebo/spawn_entity": "gazebo_msgs/srv/SpawnEntity",
    "/unpause_physics": "std_srvs/srv/Empty",
    "/zensim/set_parameters": "rcl_interfaces/srv/SetParameters",
}


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Run rclpy and the bridge beside a server."""
    with ros_host(is_short=is_short) as host:
        with host.bridge() as bridge:
            yield from spawn_robots(host)
            seconds = LISTEN_SHORT_S if is_short else LISTEN_S
            yield from judge_topics(host.run(PEER, "listen", seconds, *NAMES))
            yield from judge_ways("Twist", host.run(PEER, "drive", DRIVE_S, *NAMES))
            yield from kill_node(host)
            bridge.kill()
        with host.bridge():
            yield from listen_again(host, "a bridge")
            if not is_short:
                host.pool.kill()
                with running_pool(host.server):
                    eventually(lambda: host.server.client.info().agents == 1, START_S, "the end")
                    wait_until_driven(host.server, ROBOTS)
                    yield from listen_again(host, "an agent")
    if not is_short:
        stamped = ("--ros-bridge-cmd-vel", "twist_stamped")
        with ros_host(agent_options=stamped) as host, host.bridge():
            names = spawn_lidar_robots(host.server, ROBOTS)
            yield from judge_ways("TwistStamped", host.run(PEER, "drive_stamped", DRIVE_S, *names))
        yield from answer_scans()
    yield from check_as_users_do()


def spawn_robots(host: RosHost) -> Iterator[Figure]:
    """Spawn as the tutorial does, over DDS."""
    folder = Path(builtin_models.__file__).parent.parent / "models"
    found = host.run(DDS_CLIENT, "spawn", str(folder / "box_bot_lidar.urdf"), str(ROBOTS))
    wait_until_driven(host.server, ROBOTS)
    yield none_of(naming("spawns refused", found["refused"]), len(found["refused"]))
    yield Figure(what="replies", unit="ms", samples=tuple(found["ms"]))
    yield all_of("robots driven", host.server.client.info().claimed, ROBOTS)


def judge_topics(found: dict[str, Any]) -> Iterator[Figure]:
    """Compare what a late node found and received with what is there."""
    wrong = [
        name
        for name, wanted in PROFILES.items()
        if not found["qos"][name] or any(one != wanted for one in found["qos"][name])
    ]
    missing = [name for name, kind in SERVICES.items() if found["services"].get(name) != [kind]]
    yield none_of(
        naming("topics of a late node without a message", found["silent"]), len(found["silent"])
    )
    yield none_of(naming("topics with another type or profile", wrong), len(wrong))
    yield none_of(naming("services missing", missing), len(missing))
    yield none_of("messages out of order", found["disorder"])
    yield Figure(what="odometry of a robot", unit="Hz", samples=(found["odom_hz"],))
    yield at_most("clock less odometry", [found["clock_off_s"]], CLOCK_S, "s", is_timed=True)


def judge_ways(kind: str, found: dict[str, Any]) -> Iterator[Figure]:
    """Compare the ways of robots with what they were commanded."""
    # The node ends its drive some milliseconds late.
    spans = zip(found["ways_m"], found["seconds"], strict=True)
    ways_m = [way_m * float(DRIVE_S) / seconds for way_m, seconds in spans]
    yield all_of(f"robots driven with {kind}", len(ways_m), ROBOTS)
    yield from within(f"way with {kind}", ways_m or [0.0], WAY_M, "m")


def kill_node(host: RosHost) -> Iterator[Figure]:
    """Kill a node that commands; its robots have to stop."""
    with host.running(*host.python(PEER, "hold", "0", *NAMES)) as node:
        assert read_ready(node)
        moving = _measure_way(host)
        node.kill()
    _let_steps_pass(host, 240)
    yield all_of("robots move until their node is killed", moving, STOPPED_M, "m")
    yield at_most("then they rest", [_measure_way(host)], STOPPED_M, "m")


def listen_again(host: RosHost, killed: str) -> Iterator[Figure]:
    """Listen after something was killed and started again."""
    silent = host.run(PEER, "listen", "0.1", *NAMES)["silent"]
    yield none_of(naming(f"silent topics after {killed} was killed", silent), len(silent))


def check_as_users_do() -> Iterator[Figure]:
    """Run the checks of users, but those of services: rclpy over Fast DDS gets no reply."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory()))
        network = RosNetwork(free_endpoint(), folder)
        first = stack.enter_context(running_up(network))
        stack.enter_context(network.bridge())
        said = []
        for words in CHECKS:
            command = network.python(CHECK, *words)
            with network.running(*command) as node:
                if words[0] == "resume" and read_line(node) == "ready":
                    first.kill()
                    stack.enter_context(running_up(network))
                said.append(node.communicate(timeout=CHECK_S)[0].strip())
    yield from judge_checks(said)


@contextmanager
def running_up(network: RosNetwork) -> Iterator["subprocess.Popen[str]"]:
    """Run ten robots that nothing drives, as a user does."""
    options = ("--behaviour", "none", "--no-viewer", "--json", "--listen", network.endpoint)
    with running("up", *options, *BRIDGED) as process:
        read_json_line(process)
        yield process


def judge_checks(said: list[str]) -> Iterator[Figure]:
    """Read the figures that checks print; a check that fails prints why."""
    failed = []
    for line, (pattern, what, unit) in zip(said, CHECKS.values(), strict=True):
        if found := re.search(pattern, line):
            yield Figure(what=what, unit=unit, samples=(float(found[1]),))
        else:
            failed.append(line or f"no line of {what}")
    yield none_of(naming("checks of ros2_check.py that fail", failed), len(failed))


def _measure_way(host: RosHost) -> float:
    before = read_places(host.server, NAMES)
    _let_steps_pass(host, 60)
    return float(np.linalg.norm(read_places(host.server, NAMES) - before, axis=1).max())


def _let_steps_pass(host: RosHost, steps: int) -> None:
    wanted = host.server.steps() + steps
    eventually(lambda: host.server.steps() >= wanted, START_S, "steps")


def answer_scans() -> Iterator[Figure]:
    """Let controllers of rclpy answer scans in lockstep; compare runs."""
    states, misses = [], 0
    for delay_s in DELAYS_S:
        with ros_host(*WAIT) as host, host.bridge():
            names = spawn_lidar_robots(host.server, ROBOTS)
            with host.running(*host.python(PEER, "answer", delay_s, *names)) as node:
                states.append(step_controllers(host, node, names))
                misses += sum(read_stats(host.server).misses.values())
    yield at_most(f"lockstep: states of {len(states)} runs", [len(set(states))], 1, "")
    yield none_of("lockstep: answers missed", misses)


def step_controllers(host: RosHost, node: "subprocess.Popen[str]", names: list[str]) -> str:
    """Step a world that waits for controllers; return the hash of its state."""
    assert read_ready(node)
    assert host.run(DDS_CLIENT, "lockstep", *names)["refused"] == []
    # The bridge subscribes some seconds after the node.
    announced = "@/*/@ros2_lv/MS/*/sensor_msgs§msg§LaserScan/**"
    bus = host.server.bus
    eventually(lambda: len(bus.list_tokens(announced)) >= len(names), START_S, "subscriptions")
    wait_until_active(host.server, "s1")
    host.server.client.simulate_steps(STEPS)
    return state_hash(host.server.bus)
