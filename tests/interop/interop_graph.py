"""The graph

A peer joins when ten robots are driven, and lists nodes, topics and services until nothing is
missing. It compares each type hash with the one that it computes itself.
"""

from collections.abc import Iterator
from typing import Any

from benchmarks.figures import Figure
from tests.interop.acceptance import all_of, at_most, naming, none_of
from tests.interop.foreign_peers import Stage, list_routers, stage
from tests.proto.ros_hashes import hash_of_message, hash_of_service
from zensim.proto.ros2.rmw_keys import to_dds_type
from zensim.proto.ros2.ros_service_catalog import ROS_SERVICES

ROBOTS, ROBOTS_WHEN_SHORT = 10, 3
COMPLETE_S = 5.0
WRONG_IN_HIROZ = (
    # As if it were in a folder `action`, and without the canceled goals.
    "action_msgs/srv/CancelGoal",
    # Without the types that the result refers to.
    "simulation_interfaces/action/SimulateSteps_GetResult",
)
"""Services that hiroz 0.2.0 hashes otherwise than ROS 2; rosbags computes them instead."""
NOT_IN_HIROZ = ("rcl_interfaces/msg/Log",)
"""Messages of a package that hiroz 0.2.0 has, without these; rosbags hashes them, too."""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """List the graph of robots with an agent in one pool."""
    robots = ROBOTS_WHEN_SHORT if is_short else ROBOTS
    for router in list_routers(is_short=is_short):
        with stage(router) as network:
            names = network.spawn(robots)
            with network.agents("--pool", "0"):
                network.wait_until_driven(robots)
                found = read_graph(network)
        yield from judge_graph(router, names, found)


def read_graph(network: Stage, *options: str) -> dict[str, Any]:
    """List the graph once it is quiet."""
    hashes = [f"{to_dds_type(one)}={hash_of_service(one)}" for one in WRONG_IN_HIROZ]
    hashes += [f"{to_dds_type(one)}={hash_of_message(one)}" for one in NOT_IN_HIROZ]
    known = [word for one in hashes for word in ("--hash", one)]
    return network.run("graph", *known, *options)


def judge_graph(router: str, names: list[str], found: dict[str, Any]) -> Iterator[Figure]:
    """Compare a graph with what robots and the server announce."""
    nodes = {f"/{name}/agent" for name in names} | {"/zensim"}
    missing = sorted(nodes - set(found["nodes"]))
    wanted = {f"/{name}/{topic}" for name in names for topic in ("odom", "cmd_vel", "tf_static")}
    wanted |= {"/tf", "/tf_static"} if names else set()
    wanted |= {"/clock", "/rosout", *(one.name for one in ROS_SERVICES)}
    absent = sorted(wanted - {one["name"] for one in found["endpoints"]})
    equal, unequal, unknown = found["equal"], found["unequal"], found["unknown"]
    yield none_of(naming(f"{router}: nodes missing", missing), len(missing))
    yield none_of(naming(f"{router}: topics and services missing", absent), len(absent))
    yield none_of(naming(f"{router}: types with another hash", unequal), len(unequal))
    yield none_of(naming(f"{router}: types that the peer does not know", unknown), len(unknown))
    yield all_of(f"{router}: types with an equal hash", len(equal), 1)
    tokens = f"{router}: {found['tokens']} nodes and endpoints complete"
    yield at_most(tokens, [found["complete_ms"] * 1e-3], COMPLETE_S, "s", is_timed=True)
