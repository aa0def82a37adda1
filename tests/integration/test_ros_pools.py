"""ROS 2 topics of a pool's robots: rmw_zenoh's rules, and commands."""

from collections.abc import Iterator
from typing import Any

import pytest
import zenoh

from tests.integration.processes import Server, eventually, running, serving, wait_for_agents
from tests.integration.ros_client_process import session_of
from tests.integration.ros_rules import check_bytes, check_topic
from tests.integration.ros_subscriptions import (
    DISCOVERY_S,
    LATCHED,
    TYPES,
    place_of,
    publishers_of,
    read_late_joining,
    receive_samples,
    tokens,
)
from tests.proto.ros_oracle import HUMBLE
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Twist, TwistStamped, Vector3
from zensim.proto.ros2.rmw_keys import make_data_key
from zensim.proto.ros2.type_hash import hash_type

ROBOTS = ("r1", "r2", "r3")
FASTER = Vector3(x=0.5)
OF_POOL = tuple(topic for topic in TYPES if topic != "/clock")


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving("--ros-domain", "0") as found:
        for name in ROBOTS:
            found.zensim("spawn", "box_bot", "-n", name, "-y", name[1:])
        with running("agent", "--pool", "0", "--connect", found.endpoint):
            wait_for_agents(found, ROBOTS)
            yield found


@pytest.fixture(scope="module")
def session(server: Server) -> Iterator[zenoh.Session]:
    with session_of(server) as found:
        eventually(lambda: all(publishers_of(found, t) for t in OF_POOL), DISCOVERY_S, "tokens")
        yield found


@pytest.mark.parametrize("topic", OF_POOL)
def test_topic_of_a_pool_follows_the_rules_of_rmw(session: zenoh.Session, topic: str) -> None:
    samples = receive_samples(session, topic)

    publishers = check_topic(publishers_of(session, topic), samples)

    assert {(one.name, one.ros_type) for one in publishers} == {(topic, TYPES[topic])}
    for received in samples:
        check_bytes(TYPES[topic], received.payload)


def test_late_joiner_of_a_pool_receives_its_own_robot_only(session: zenoh.Session) -> None:
    samples = read_late_joining(session, "/r2/tf_static", 1)

    assert [received.key.split("/")[1] for received in samples] == ["r2"]


@pytest.mark.parametrize(("topic", "suffix"), [("/tf_static", "base_footprint"), ("/tf", "odom")])
def test_frames_that_all_robots_share_begin_with_their_names(
    session: zenoh.Session, topic: str, suffix: str
) -> None:
    samples = (
        read_late_joining(session, topic, 1)[-1:]
        if topic in LATCHED
        else receive_samples(session, topic, 9)
    )

    roots = {
        root for sample in samples for root in roots_of(sample.payload) if root.endswith(suffix)
    }
    assert roots == {f"{name}/{suffix}" for name in ROBOTS}


def test_frames_of_all_robots_are_in_one_message(session: zenoh.Session) -> None:
    (received,) = receive_samples(session, "/tf", 1)

    assert {f"{name}/odom" for name in ROBOTS} <= roots_of(received.payload)


def roots_of(payload: bytes) -> set[str]:
    message: Any = HUMBLE.deserialize_cdr(payload, TYPES["/tf"])
    return {str(edge.header.frame_id) for edge in message.transforms}


@pytest.mark.parametrize("message", [Twist(FASTER), TwistStamped(twist=Twist(FASTER))])
def test_robot_of_a_pool_is_driven(
    server: Server, session: zenoh.Session, message: Twist | TwistStamped
) -> None:
    kind = type(message)
    key = make_data_key(0, "/r2/cmd_vel", kind.ros_type, hash_type(kind))
    before = [place_of(server, name) for name in ROBOTS]

    def has_moved() -> bool:
        session.put(key, encode(message, Format.CDR))
        return abs(place_of(server, "r2") - before[1]) > 0.05

    eventually(has_moved, 20.0, "driving")
    assert place_of(server, "r3") == pytest.approx(before[2], abs=0.01)


def test_tokens_are_removed_with_a_robot_of_a_pool(server: Server, session: zenoh.Session) -> None:
    server.zensim("delete", "r1")

    eventually(lambda: not tokens(session, "@ros2_lv/0/*/*/*/*/*/%r1/**"), DISCOVERY_S, "leaving")
    assert publishers_of(session, "/r2/odom")
