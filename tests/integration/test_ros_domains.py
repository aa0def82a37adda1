"""Two ROS domains on one network: isolated topics, services and commands."""

from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass

import pytest

from tests.integration import ros_interfaces as ros
from tests.integration.processes import START_S, Server, eventually, running, serving
from tests.integration.ros_client_process import (
    CallObserver,
    make_service_call,
    result_of,
    run_observer,
    session_of,
)
from tests.integration.ros_grammar import parse_endpoints
from tests.integration.ros_subscriptions import DISCOVERY_S, tokens
from zensim.proto.messages.result_messages import ResultCode
from zensim.spawner.client.sim_client import SimClient

GET_ENTITIES = "simulation_interfaces/srv/GetEntities"
SPAWN = "simulation_interfaces/srv/SpawnEntity"
AT_ORIGIN = {"pose": {"position": {"z": 0.06}, "orientation": {"w": 1.0}}}
DOMAINS = {0: "a1", 7: "b1"}
"""Domain ids, and the robot in each domain."""


@dataclass(frozen=True)
class Network:
    """A server in domain 0, which is the router, and another world in domain 7."""

    server: Server
    other: SimClient


@pytest.fixture(scope="module")
def network() -> Iterator[Network]:
    with ExitStack() as stack:
        server = stack.enter_context(serving("--ros-domain", "0"))
        joining = ("--connect", server.endpoint, "--world-name", "other", "--ros-domain", "7")
        stack.enter_context(running("serve", *joining))
        other = SimClient(server.bus, "other")
        other.wait_for_server(START_S)
        server.zensim("spawn", "box_bot", "-n", "a1")
        stack.enter_context(running("agent", "a1", "--connect", server.endpoint))
        with run_observer(server, 7) as observe:
            spawn(observe, "b1")
        stack.enter_context(running("agent", "b1", *joining))
        eventually(lambda: bool(other.entity_model("b1").agent), START_S, "claiming")
        eventually(lambda: bool(server.client.entity_model("a1").agent), START_S, "claiming")
        yield Network(server, other)


def spawn(observe: CallObserver, name: str) -> None:
    resource = {"uri": "box_bot"}
    given = {"name": name, "entity_resource": resource, "initial_pose": AT_ORIGIN}
    response = make_service_call(observe)("/spawn_entity", SPAWN, ros.SPAWN_V2_HASH, **given)
    assert result_of(response) == ResultCode.OK


@pytest.fixture(scope="module", params=[0, pytest.param(7, marks=pytest.mark.long_form)])
def domain(request: pytest.FixtureRequest) -> int:
    return int(request.param)


@pytest.fixture(scope="module")
def observe(network: Network, domain: int) -> Iterator[CallObserver]:
    with run_observer(network.server, domain) as found:
        yield found


def test_tokens_are_of_one_domain_each(network: Network) -> None:
    expected = {(0, "/zensim"), (0, "/a1/agent"), (7, "/zensim"), (7, "/b1/agent")}

    with session_of(network.server) as session:

        def list_nodes() -> set[tuple[int, str]]:
            graph = parse_endpoints(tokens(session, "@ros2_lv/**"))
            return {(one.node.domain, one.node.name) for one in graph}

        # An agent claims its robot before its node is known.
        eventually(lambda: list_nodes() >= expected, DISCOVERY_S, "nodes")
        assert list_nodes() == expected


def test_domain_lists_its_own_robot_only(observe: CallObserver, domain: int) -> None:
    (other,) = {*DOMAINS.values()} - {DOMAINS[domain]}
    eventually(lambda: f"/{DOMAINS[domain]}/odom" in observe("topics"), DISCOVERY_S, "topics")

    topics = observe("topics")

    assert [topic for topic in topics if topic.startswith(f"/{other}/")] == []
    assert len(observe("publishers", topic="/clock")) == 1


def test_services_are_those_of_the_domain(observe: CallObserver, domain: int) -> None:
    response = make_service_call(observe)("/get_entities", GET_ENTITIES, ros.GET_ENTITIES_HASH)

    assert response is not None
    assert response["entities"] == [DOMAINS[domain]]


def test_frames_are_those_of_the_domain(observe: CallObserver, domain: int) -> None:
    qos = ":1:,1:,:,:,,"
    given = {"kind": "tf2_msgs/msg/TFMessage", "count": 2, "within_s": 2.0, "qos": qos}

    received = eventually(
        lambda: observe("receive", topic="/tf_static", **given) or None, DISCOVERY_S, "transforms"
    )

    children = {edge["child_frame_id"] for message in received for edge in message["transforms"]}
    assert {child.partition("/")[0] for child in children} == {DOMAINS[domain]}


def test_command_in_another_domain_moves_no_robot(network: Network) -> None:
    before = network.other.entity_state("b1").pose.position.x

    def has_moved() -> bool:
        with_twist = {"kind": "geometry_msgs/msg/Twist", "fields": {"linear": {"x": 0.5}}}
        observe_b("publish", topic="/b1/cmd_vel", **with_twist)
        observe_b("publish", topic="/a1/cmd_vel", **with_twist)
        return network.server.client.entity_state("a1").pose.position.x > 0.2

    with run_observer(network.server, 0) as observe_b:
        eventually(has_moved, 20.0, "driving")

    after = network.other.entity_state("b1").pose.position.x
    assert after == pytest.approx(before, abs=0.01)
