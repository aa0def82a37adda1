"""Tokens and late-joining subscriptions, like rmw_zenoh."""

from collections.abc import Callable

import zenoh
import zenoh.ext

from tests.integration.processes import Server, eventually
from tests.integration.ros_interfaces import OF_HUMBLE
from tests.integration.ros_rules import ReceivedSample, parse_publisher_token, to_received_sample

ODOMETRY, TF = "nav_msgs/msg/Odometry", "tf2_msgs/msg/TFMessage"
TYPES = {
    "/clock": "rosgraph_msgs/msg/Clock",
    "/r1/joint_states": "sensor_msgs/msg/JointState",
    "/r1/odom": ODOMETRY,
    "/r1/robot_description": "std_msgs/msg/String",
    "/r1/tf": TF,
    "/r1/tf_static": TF,
    "/tf": TF,
    "/tf_static": TF,
}
LATCHED = ("/r1/robot_description", "/r1/tf_static", "/tf_static")
TRANSIENT_LOCAL = ":1:,1:,:,:,,"
DISCOVERY_S = 60.0


def tokens(session: zenoh.Session, pattern: str) -> list[str]:
    replies = session.liveliness().get(pattern, zenoh.handlers.FifoChannel(4096), timeout=60.0)
    return [str(reply.ok.key_expr) for reply in replies if reply.ok]


def publishers_of(session: zenoh.Session, topic: str) -> list[str]:
    return tokens(session, f"@ros2_lv/0/*/*/*/MP/*/*/*/{topic.replace('/', '%')}/**")


def subscribe_transient_local(
    session: zenoh.Session, key: str, hear: Callable[[zenoh.Sample], object]
) -> "zenoh.ext.AdvancedSubscriber[None]":
    """Subscribe to a transient_local topic like rmw_zenoh."""
    return zenoh.ext.declare_advanced_subscriber(
        session,
        key,
        hear,
        history=zenoh.ext.HistoryConfig(detect_late_publishers=True, max_samples=1),
        recovery=zenoh.ext.RecoveryConfig(heartbeat=True),  # type: ignore[call-arg]
        subscriber_detection=True,
    )


def key_of(token: str) -> str:
    """Find the data key of a publisher of any distribution."""
    return parse_publisher_token(token, has_hashes=OF_HUMBLE not in token).key


def read_late_joining(session: zenoh.Session, topic: str, count: int) -> list[ReceivedSample]:
    """Subscribe to a transient_local topic like rmw_zenoh, and wait for earlier samples."""
    found = eventually(lambda: publishers_of(session, topic) or None, DISCOVERY_S, topic)
    key = key_of(found[0])
    samples: list[ReceivedSample] = []
    joiner = subscribe_transient_local(
        session, key, lambda sample: samples.append(to_received_sample(sample))
    )
    eventually(lambda: len(samples) >= count, DISCOVERY_S, f"late joining of {topic}")
    joiner.undeclare()
    return samples


def receive_samples(session: zenoh.Session, topic: str, count: int = 3) -> list[ReceivedSample]:
    if topic in LATCHED or topic.endswith(("/map", "/tf_static", "/robot_description", "/status")):
        return read_late_joining(session, topic, 1)
    found = eventually(lambda: publishers_of(session, topic) or None, DISCOVERY_S, topic)
    key = key_of(found[0])
    channel = zenoh.handlers.FifoChannel(4096)
    subscriber = session.declare_subscriber(key, channel)
    samples = [to_received_sample(subscriber.recv()) for _ in range(count)]
    subscriber.undeclare()
    return samples


def place_of(server: Server, name: str) -> float:
    return server.client.entity_state(name).pose.position.x
