"""ROS nodes in lockstep: parameters, answers on the keys of rmw_zenoh and of a bridge."""

import msgspec
import numpy as np
import pytest

from tests.fakes import MemoryBus
from tests.sim_server.fakes import ServerFixture, a_server
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import LaserScan, Twist, TwistStamped, Vector3
from zensim.proto.ros2.rmw_keys import make_data_key
from zensim.proto.ros2.type_hash import hash_type
from zensim.proto.settings.lockstep_settings import LockstepSettings, OnMiss
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.pacing.topic_answers import CLIENT_PREFIX, TopicAnswers
from zensim.sim_server.runtime import node_answers
from zensim.sim_server.runtime.node_answers import NodeAnswers

CMD, SCAN = "/r1/cmd_vel", "/r1/scan"
PARAMETER = f"lockstep.{CMD}"
TYPE_CHUNKS = "geometry_msgs::msg::dds_::Twist_/RIHS01_0"
TOKEN = f"@ros2_lv/0/ab/0/1/MP/%/%/nav/%r1%cmd_vel/{TYPE_CHUNKS}/::,10:,:,:,,"
BRIDGE_TOKEN = "@/ab/@ros2_lv/MP/r1§cmd_vel/geometry_msgs§msg§Twist/:::,10"
DRIVE_ON = Twist(linear=Vector3(x=0.3), angular=Vector3(z=0.1))


class Nodes:
    """A server with a robot, and what ROS nodes send."""

    def __init__(self, on_miss: OnMiss = "hold") -> None:
        self.server: ServerFixture = a_server("r1")
        pacing = self.server.parts.pacing
        pacing.lockstep = Lockstep(LockstepSettings(on_miss=on_miss, lockstep_timeout=1.0))
        pacing.answers = TopicAnswers(pacing.lockstep)
        self.bus, self.pacing = MemoryBus(), pacing
        self.answers = NodeAnswers(self.server.parts, self.bus, 0)

    def scan(self) -> None:
        self.bus.put_message("r1/scan", LaserScan())

    def answer(self, message: msgspec.Struct = DRIVE_ON, key: str = "") -> None:
        kind = type(message)
        ros_type = str(vars(kind)["ros_type"])
        own = key or make_data_key(0, CMD, ros_type, hash_type(kind))
        self.bus.put(own, encode(message, Format.CDR))

    @property
    def is_waiting(self) -> bool:
        self.answers.serve()
        return self.pacing.lockstep.is_waiting

    @property
    def twist(self) -> list[float]:
        self.answers.serve()
        index = self.server.world.entities.index
        raw = self.server.world.commanded_twists.select(index, np.arange(1))
        return [float(one) for one in np.frombuffer(raw, dtype="<f8")]


@pytest.fixture
def nodes() -> Nodes:
    found = Nodes()
    assert found.answers.change(PARAMETER, SCAN) == ""
    return found


@pytest.mark.parametrize("kind", ["twist", "stamped", "bridge"])
def test_robot_is_driven_by_the_answer_to_a_scan(nodes: Nodes, kind: str) -> None:
    nodes.scan()
    waited = nodes.is_waiting

    message = TwistStamped(twist=DRIVE_ON) if kind == "stamped" else DRIVE_ON
    nodes.answer(message, "r1/cmd_vel" if kind == "bridge" else "")

    assert waited
    assert not nodes.is_waiting
    assert nodes.twist == pytest.approx([0.3, 0.0, 0.1])


def test_command_that_answers_nothing_is_left_to_the_agent(nodes: Nodes) -> None:
    nodes.answer()

    assert nodes.twist == []


def test_world_is_in_lockstep_while_a_node_asks_for_it(nodes: Nodes) -> None:
    asked = nodes.pacing.is_awaited

    nodes.answers.change(PARAMETER, "")

    assert asked
    assert not nodes.pacing.is_awaited
    assert nodes.bus.subscribed_keys == []


def test_parameters_name_what_is_awaited(nodes: Nodes) -> None:
    (found,) = nodes.answers.list_parameters()

    assert (found.name, found.value) == (PARAMETER, SCAN)


@pytest.mark.parametrize("name", ["lockstep.r1/cmd_vel", "lockstep./r1/*", "lockstep."])
@pytest.mark.parametrize("value", [SCAN, "scan", "/r1/**", 3, True])
def test_parameter_that_names_no_topic_is_refused(name: str, value: str | int) -> None:
    found = Nodes()

    assert found.answers.change(name, value)
    assert found.bus.subscribed_keys == []


def test_topic_cannot_answer_itself() -> None:
    assert Nodes().answers.change(PARAMETER, CMD)


def test_topics_are_limited(monkeypatch: pytest.MonkeyPatch, nodes: Nodes) -> None:
    monkeypatch.setattr(node_answers, "MAX_ANSWERS", 1)

    assert nodes.answers.change("lockstep./r2/cmd_vel", SCAN)
    assert nodes.answers.change(PARAMETER, "/r1/odom") == ""


def test_other_parameters_are_left_alone(nodes: Nodes) -> None:
    assert nodes.answers.change("world", "empty") is None


@pytest.mark.parametrize("token", [TOKEN, BRIDGE_TOKEN], ids=["rmw_zenoh", "bridge"])
def test_node_that_ends_is_not_awaited_and_its_robot_stops(token: str) -> None:
    nodes = Nodes("wait")
    nodes.answers.change(PARAMETER, SCAN)
    alive = nodes.bus.token(token)
    nodes.scan()
    nodes.answer()
    assert nodes.twist
    nodes.scan()
    waited = nodes.is_waiting

    alive.close()

    assert waited
    assert not nodes.is_waiting
    assert nodes.twist == [0.0, 0.0, 0.0]


def test_robot_of_a_late_node_stops(nodes: Nodes) -> None:
    nodes.scan()
    nodes.answer()
    assert nodes.twist
    nodes.scan()
    assert nodes.is_waiting

    began_ns = nodes.pacing.now_ns()
    for tick in range(200):
        nodes.pacing.lockstep.find_late(began_ns + tick * 10_000_000)

    assert nodes.twist == [0.0, 0.0, 0.0]
    assert nodes.pacing.lockstep.misses == {CLIENT_PREFIX + CMD: 1}


def test_answer_that_is_no_command_drives_nothing(nodes: Nodes) -> None:
    nodes.scan()
    nodes.bus.put(make_data_key(0, CMD, "a/msg/B", "h"), b"\x00\x01\x00\x00xx")

    assert nodes.twist == []
    assert nodes.server.world.claims.rejected["malformed"] == 1


def test_answer_to_the_clock_is_awaited_after_it_was_published() -> None:
    nodes = Nodes()
    nodes.answers.change(PARAMETER, "/clock")

    nodes.answers.note_clock()
    waited = nodes.is_waiting
    nodes.answer()

    assert waited
    assert not nodes.is_waiting
