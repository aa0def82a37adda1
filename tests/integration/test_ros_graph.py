"""All ROS 2 tokens, topics and services of a network.

The tests iterate over the network's endpoints, so that new ones are covered automatically.
"""

import re
import struct
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import zenoh

from tests.integration.processes import (
    Server,
    eventually,
    running,
    running_agents,
    serving,
    wait_for_agents,
)
from tests.integration.ros_client_process import replies, session_of
from tests.integration.ros_grammar import (
    HUMBLE_HASH,
    InvalidToken,
    TokenEndpoint,
    check_hash,
    parse_endpoints,
)
from tests.integration.ros_rules import check_bytes, check_topic
from tests.integration.ros_subscriptions import (
    DISCOVERY_S,
    publishers_of,
    read_late_joining,
    receive_samples,
    tokens,
)
from tests.integration.test_ground_truth import P3D
from tests.proto.ros_oracle import HUMBLE, message_name
from zensim.proto.codec.message_codec import decode
from zensim.proto.ros2.node_messages import RosoutLog
from zensim.sim_server.description.builtin_models import read_builtin_model

ODOMETRY, TF, TEXT = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage", "std_msgs/msg/String"
STATES = "sensor_msgs/msg/JointState"
OF_ROBOT = {
    "odom": ODOMETRY,
    "tf": TF,
    "tf_static": TF,
    "joint_states": STATES,
    "robot_description": TEXT,
}
ROBOTS = ("/team/r1", "/r2", "/r3")
ACTION = "/simulate_steps/_action"
PUBLISHED = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/rosout": "rcl_interfaces/msg/Log",
    "/map": "nav_msgs/msg/OccupancyGrid",
    "/model_states": "gazebo_msgs/msg/ModelStates",
    "/link_states": "gazebo_msgs/msg/LinkStates",
    "/tf": TF,
    "/tf_static": TF,
    f"{ACTION}/feedback": "simulation_interfaces/action/SimulateSteps_FeedbackMessage",
    f"{ACTION}/status": "action_msgs/msg/GoalStatusArray",
    "/team/r1/ground_truth/state": ODOMETRY,
    **{f"{robot}/{topic}": kind for robot in ROBOTS for topic, kind in OF_ROBOT.items()},
}
LATCHED = ("tf_static", "robot_description", "status", "map")
RELIABLE_10, TRANSIENT_LOCAL_1 = "::,10", ":1:,1"
ROSOUT_QOS = ":1:,1000"
SILENT = (f"{ACTION}/feedback", "/rosout")
"""Published for goals only, see `test_ros_action`; and for warnings."""
GID = bytes(range(16))
SEQUENCE, HEADER = 41, b"\x00\x01"


@pytest.fixture(
    scope="module", params=["jazzy", pytest.param("humble", marks=pytest.mark.long_form)]
)
def distribution(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(scope="module")
def server(distribution: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    """Run a robot with a single agent and ground truth, and two robots in a pool."""
    file = tmp_path_factory.mktemp("robot") / "seen.urdf"
    ros = ("--ros-distro", distribution)
    with serving("--ros-domain", "0", *ros) as found:
        write_with_truth(file, found)
        with (
            running_agents(found, "r1", options=ros),
            running("agent", "--pool", "0", "--connect", found.endpoint, *ros),
        ):
            wait_for_agents(found, ("r2", "r3"))
            yield found


def write_with_truth(file: Path, server: Server) -> None:
    file.write_text(read_builtin_model("box_bot").replace("</robot>", P3D), encoding="utf-8")
    server.zensim("spawn", str(file), "-n", "r1", "--namespace", "team/r1")
    for place, name in enumerate(("r2", "r3"), 1):
        server.zensim("spawn", "box_bot", "-n", name, "-y", str(place))


@pytest.fixture(scope="module")
def session(server: Server) -> Iterator[zenoh.Session]:
    with session_of(server) as found:
        eventually(
            lambda: all(publishers_of(found, one) for one in PUBLISHED), DISCOVERY_S, "tokens"
        )
        yield found


@pytest.fixture(scope="module")
def graph(session: zenoh.Session) -> list[TokenEndpoint]:
    return parse_endpoints(tokens(session, "@ros2_lv/**"))


def test_each_token_matches_the_grammar_and_the_other_tokens(graph: list[TokenEndpoint]) -> None:
    nodes = {one.node.name for one in graph}
    pools = {name for name in nodes if re.fullmatch(r"/zensim_pool_[0-9a-f]{8}_(1|static)", name)}

    assert len(pools) == 2
    assert nodes - pools == {"/zensim", *(f"{robot}/agent" for robot in ROBOTS)}
    assert {one.node.domain for one in graph} == {0}


def test_each_hash_matches_an_independent_implementation(
    graph: list[TokenEndpoint], distribution: str
) -> None:
    for one in graph:
        check_hash(one, has_hashes=distribution != "humble")


def test_published_topics_are_the_documented_ones(graph: list[TokenEndpoint]) -> None:
    published = [one for one in graph if one.kind == "MP"]

    assert {one.name: one.ros_type for one in published} == PUBLISHED
    for one in published:
        is_latched = one.name.endswith(LATCHED)
        usual = TRANSIENT_LOCAL_1 if is_latched else RELIABLE_10
        assert one.qos == (ROSOUT_QOS if one.name == "/rosout" else usual), one


def test_robots_subscribe_to_commands_of_both_types(graph: list[TokenEndpoint]) -> None:
    received = {(one.name, one.ros_type) for one in graph if one.kind == "MS"}

    kinds = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
    assert received == {(f"{robot}/cmd_vel", kind) for robot in ROBOTS for kind in kinds}


@pytest.mark.parametrize("topic", [topic for topic in PUBLISHED if topic not in SILENT])
def test_each_topic_follows_rmw_rules_and_matches_rosbags_bytes(
    session: zenoh.Session, distribution: str, topic: str
) -> None:
    samples = receive_samples(session, topic)

    check_topic(publishers_of(session, topic), samples, has_hashes=distribution != "humble")
    for received in samples:
        check_bytes(PUBLISHED[topic], received.payload)


def test_warning_of_an_agent_reaches_a_late_subscriber_of_rosout(
    session: zenoh.Session, distribution: str
) -> None:
    session.put("team/r1/cmd_vel", b"no command", encoding="application/cdr")
    (token,) = [one for one in publishers_of(session, "/rosout") if "%team%r1" in one]

    def has_arrived() -> bool:
        samples = read_late_joining(session, "/rosout", 1)
        check_topic([token], samples[-1:], has_hashes=distribution != "humble")
        check_bytes("rcl_interfaces/msg/Log", samples[-1].payload)
        log = decode(RosoutLog, samples[-1].payload)
        return log.name == "team.r1.agent" and "r1" in log.msg

    eventually(has_arrived, DISCOVERY_S, "the warning")


def test_each_service_replies_to_unreadable_requests(
    server: Server, graph: list[TokenEndpoint]
) -> None:
    served = [one for one in graph if one.kind == "SS"]
    assert len({one.key for one in served}) == len(served) > 30

    for one in served:
        (reply,) = replies(server, one.key, HEADER, struct.pack("<qqB", SEQUENCE, 7, 16) + GID)
        check_response(one, reply)


def check_response(endpoint: TokenEndpoint, reply: zenoh.Sample) -> None:
    assert str(reply.key_expr) == endpoint.key
    assert reply.attachment is not None
    sequence, time_ns, length = struct.unpack("<qqB", reply.attachment.to_bytes()[:17])
    assert (sequence, length, reply.attachment.to_bytes()[17:]) == (SEQUENCE, 16, GID)
    assert time_ns > 7
    kind = message_name(f"{endpoint.ros_type}_Response")
    payload = reply.payload.to_bytes()
    response: Any = HUMBLE.deserialize_cdr(payload, kind)
    assert bytes(HUMBLE.serialize_cdr(response, kind)) == payload, endpoint
    if hasattr(response, "result") and hasattr(response.result, "error_message"):
        assert response.result.error_message, endpoint


def test_other_domains_have_no_token(session: zenoh.Session) -> None:
    found = tokens(session, "@ros2_lv/**")

    assert {token.split("/")[1] for token in found} == {"0"}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("@ros2_lv/0/", "@ros2_lv//"),
        ("/%/", "//"),
        ("/%team%r1%odom", "/team%r1%odom"),
        ("%odom", "%2odom"),
        ("%odom", "%%odom"),
        ("%odom", "%my-odom"),
        ("dds_::", "::"),
        ("/RIHS01_3", "/RIHS01_"),
        (":,10:", ":10:"),
        ("/::,10", "/:,10"),
    ],
)
def test_grammar_finds_a_broken_token(
    session: zenoh.Session, distribution: str, old: str, new: str
) -> None:
    found = tokens(session, "@ros2_lv/0/*/*/*/*/*/%team%r1/**")
    old = old.replace("RIHS01_3", HUMBLE_HASH) if distribution == "humble" else old
    assert parse_endpoints(found)

    with pytest.raises(InvalidToken):
        parse_endpoints([token.replace(old, new) for token in found])


def test_grammar_misses_the_node_of_an_endpoint(session: zenoh.Session) -> None:
    found = tokens(session, "@ros2_lv/0/*/*/*/*/*/%r2/**")

    with pytest.raises(InvalidToken, match="unknown_node"):
        parse_endpoints([token for token in found if "/NN/" not in token])
