"""Process that declares the liveliness tokens of robots on ROS 2, and nothing else: a floor.

`python -m benchmarks.bare_tokens ENDPOINT COUNT` declares those of this many robots in one session,
prints a line with their number and the memory that they took here, and keeps them.
"""

import os
import sys
import time
import uuid
from collections.abc import Iterator

import msgspec
import psutil

from zensim.proto.bus import BusConfig, open_bus
from zensim.proto.messages.standard_messages import (
    JointState,
    Odometry,
    String,
    TFMessage,
    Twist,
    TwistStamped,
)
from zensim.proto.process_limits import die_with_supervisor
from zensim.proto.ros2.liveliness_tokens import (
    LATCHED,
    RELIABLE_10,
    EndpointKind,
    GraphEndpoint,
    GraphNode,
    Qos,
    make_endpoint_token,
    make_node_token,
)
from zensim.proto.ros2.ros_graph import MAX_NODES_PER_ID
from zensim.proto.ros2.type_hash import hash_type

KIBIBYTES = 1024.0
SETTLE_S = 1.0
"""Time in which the memory of the session stops to grow."""
ENDPOINTS: tuple[tuple[EndpointKind, str, type[msgspec.Struct], Qos], ...] = (
    ("MP", "odom", Odometry, RELIABLE_10),
    ("MP", "tf", TFMessage, RELIABLE_10),
    ("MP", "tf_static", TFMessage, LATCHED),
    ("MP", "joint_states", JointState, RELIABLE_10),
    ("MP", "robot_description", String, LATCHED),
    ("MS", "cmd_vel", Twist, RELIABLE_10),
    ("MS", "cmd_vel", TwistStamped, RELIABLE_10),
)
TOKENS_OF_ROBOT = 1 + len(ENDPOINTS)
"""Tokens of a box_bot beyond the first hundred of its pool."""


class DeclaredTokens(msgspec.Struct, frozen=True):
    """What was declared."""

    count: int
    kib: float
    """Memory of the process for all of them."""


def list_tokens(robots: int) -> Iterator[str]:
    """List the tokens of robots, as pools write them."""
    zid, number = "", 0
    for robot in range(robots):
        if robot % MAX_NODES_PER_ID == 0:
            zid = f"{uuid.uuid4().int | 1 << 127:x}"
        name = f"/box_bot{robot}"
        node = GraphNode(domain=0, zid=zid, number=number, namespace=name, name="agent")
        yield make_node_token(node)
        for kind, topic, message, qos in ENDPOINTS:
            number += 1
            yield make_endpoint_token(
                GraphEndpoint(
                    node=node,
                    number=number,
                    kind=kind,
                    name=f"{name}/{topic}",
                    ros_type=str(getattr(message, "ros_type", "")),
                    type_hash=hash_type(message),
                    qos=qos,
                )
            )
        number += 1


def read_memory_kib(pid: int) -> float:
    """Read the resident memory of a process."""
    return float(psutil.Process(pid).memory_info().rss) / KIBIBYTES


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    with open_bus(BusConfig(connect=(sys.argv[1],))) as bus:
        listed = list(list_tokens(int(sys.argv[2])))
        before_kib = read_memory_kib(os.getpid())
        held = [bus.token(key) for key in listed]
        time.sleep(SETTLE_S)
        declared = DeclaredTokens(len(held), read_memory_kib(os.getpid()) - before_kib)
        sys.stdout.write(msgspec.json.encode(declared).decode() + "\n")
        sys.stdout.flush()
        while True:
            time.sleep(SETTLE_S)
