"""Parameter services and type descriptions of nodes, as a client of rmw_zenoh calls them."""

from typing import TypeVar

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.integration.processes import eventually
from tests.proto.ros2.token_parser import parse_token
from tests.proto.ros_hashes import hash_of_message, hash_of_service
from tests.proto.ros_oracle import HUMBLE, ros_bytes
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.standard_messages import Odometry
from zensim.proto.ros2 import node_messages as messages
from zensim.proto.ros2 import ros_graph
from zensim.proto.ros2.liveliness_tokens import GraphEndpoint, parse_endpoint_token
from zensim.proto.ros2.node_messages import NamedParameter, ParameterType, ParameterValue
from zensim.proto.ros2.node_services import (
    ALL_SERVICES,
    NodeParameter,
    NodeParameters,
    NodeServices,
    ParameterContent,
    make_parameter_value,
)
from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment
from zensim.proto.ros2.rmw_keys import make_data_key, qualify_name
from zensim.proto.ros2.ros_graph import RosGraph, RosTopic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.ros2.type_hash import find_service_type, hash_service, hash_type
from zensim.proto.sample_messages import make_sample_message

KINDS = [
    *(kind for halves in ALL_SERVICES.values() for kind in halves),
    messages.ParameterDescriptor,
    messages.RosoutLog,
]
ODOM = RosTopic("r1/odom", Odometry)
WIDTH = NodeParameter("drive.width_m", 0.4, "Between wheels.", "it is welded")
Response = TypeVar("Response", bound=msgspec.Struct)
ASKED = Attachment(7, 1, bytes(range(16)))


def name_of(kind: type[msgspec.Struct]) -> str:
    return str(vars(kind)["ros_type"])


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_message_of_nodes_has_the_bytes_and_hash_of_another_implementation(
    kind: type[msgspec.Struct],
) -> None:
    message = make_sample_message(kind)

    written = encode(message, Format.CDR)

    assert decode(kind, written) == message
    assert written == ros_bytes(message, name_of(kind))
    assert hash_type(kind) == hash_of_message(name_of(kind))


@pytest.mark.parametrize("name", ALL_SERVICES)
def test_service_of_nodes_has_the_hash_of_another_implementation(name: str) -> None:
    request, response = ALL_SERVICES[name]

    assert hash_service(request, response) == hash_of_service(find_service_type(request))


class Network:
    """A node `/r1/agent` with services, and its clients."""

    def __init__(self, settings: RosSettings = RosSettings(), pattern: str = "") -> None:  # noqa: B008
        self.bus = MemoryBus()
        self.graph = RosGraph(self.bus, settings)
        node = self.graph.add_node("r1", "agent")
        assert node is not None
        self.node = node
        self.node.add_topic_endpoint("MP", ODOM)
        self.services = NodeServices(self.bus, settings.domain, pattern)
        self.services.add(self.node, NodeParameters(lambda: (WIDTH,)))
        self.services.poll()
        self.bus.pumps.append(self.services.poll)

    def ask(self, request: bytes, service: str, node: str = "/r1/agent") -> list[bytes]:
        kinds = ALL_SERVICES[service]
        key = make_data_key(0, f"{node}/{service}", find_service_type(kinds[0]), "RIHS01_0")
        found = self.bus.ask(key, request, write_attachment(ASKED))
        for answer in found:
            read = read_attachment(answer.attachment)
            assert read is not None
            assert (read.sequence_number, read.gid) == (ASKED.sequence_number, ASKED.gid)
        return [answer.payload for answer in found]

    def call(self, request: msgspec.Struct, kind: type[Response]) -> Response:
        service = next(name for name, halves in ALL_SERVICES.items() if halves[0] is type(request))
        (payload,) = self.ask(encode(request, Format.CDR), service)
        return decode(kind, payload)

    def set(self, *parameters: NamedParameter) -> list[tuple[bool, bool]]:
        """Set parameters one by one and together; return which succeeded, and which say why."""
        each = self.call(
            messages.SetParametersRequest(parameters), messages.SetParametersResponse
        ).results
        together = self.call(
            messages.SetParametersAtomicallyRequest(parameters),
            messages.SetParametersAtomicallyResponse,
        ).result
        return [(one.successful, bool(one.reason)) for one in (*each, together)]


@pytest.fixture(params=["", "**/agent"], ids=["own queryable", "shared queryable"])
def network(request: pytest.FixtureRequest) -> Network:
    return Network(pattern=request.param)


def test_services_of_a_node_are_announced_below_its_name(network: Network) -> None:
    found = [parse_endpoint_token(token) for token in network.bus.list_tokens("@ros2_lv/**")]

    served = {one.key: one.ros_type for one in found if one and one.kind == "SS"}
    assert served == {
        f"r1/agent/{name}": find_service_type(request)
        for name, (request, _) in ALL_SERVICES.items()
    }
    network.node.close()
    assert network.bus.list_tokens("@ros2_lv/**") == []


def test_values_types_and_descriptions_are_those_of_the_parameters(network: Network) -> None:
    names = ("use_sim_time", WIDTH.name, "nothing")

    values = network.call(messages.GetParametersRequest(names), messages.GetParametersResponse)
    types = network.call(
        messages.GetParameterTypesRequest(names), messages.GetParameterTypesResponse
    )
    described = network.call(
        messages.DescribeParametersRequest(names), messages.DescribeParametersResponse
    )

    assert values.values == (
        ParameterValue(ParameterType.BOOL, bool_value=True),
        ParameterValue(ParameterType.DOUBLE, double_value=0.4),
        ParameterValue(),
    )
    assert types.types == (1, 3, 0)
    assert [(one.name, one.type, one.read_only) for one in described.descriptors] == [
        ("use_sim_time", 1, True),
        (WIDTH.name, 3, True),
        ("nothing", 0, False),
    ]


@pytest.mark.parametrize(
    ("prefixes", "depth", "expected"),
    [
        ((), 0, ("drive.width_m", "use_sim_time")),
        ((), 1, ("use_sim_time",)),
        (("drive",), 0, ("drive.width_m",)),
        (("drive",), 1, ("drive.width_m",)),
        (("driv",), 0, ()),
        (("use_sim_time",), 1, ("use_sim_time",)),
    ],
)
def test_names_are_listed_by_prefix_and_depth(
    network: Network, prefixes: tuple[str, ...], depth: int, expected: tuple[str, ...]
) -> None:
    request = messages.ListParametersRequest(prefixes, depth)

    listed = network.call(request, messages.ListParametersResponse).result

    assert listed.names == expected
    assert listed.prefixes == (("drive",) if "drive.width_m" in expected else ())


def test_setting_a_parameter_is_refused_with_a_reason(network: Network) -> None:
    assert network.set(NamedParameter(WIDTH.name, make_parameter_value(0.5))) == [
        (False, True),
        (False, True),
    ]
    assert network.set(NamedParameter("nothing", make_parameter_value("x"))) == [
        (False, True),
        (False, True),
    ]


def test_setting_the_value_that_is_there_succeeds(network: Network) -> None:
    same = NamedParameter("use_sim_time", make_parameter_value(content=True))
    other = NamedParameter(WIDTH.name, make_parameter_value(0.5))

    assert network.set(same) == [(True, False), (True, False)]
    assert network.set(same, other) == [(True, False), (False, True), (False, True)]


@pytest.mark.parametrize(
    ("content", "field"),
    [
        (True, "bool_value"),
        (3, "integer_value"),
        (0.5, "double_value"),
        ("a", "string_value"),
        (("a", "b"), "string_array_value"),
        ((0.5, 1.0), "double_array_value"),
    ],
)
def test_value_is_in_the_field_of_its_type(content: ParameterContent, field: str) -> None:
    found = make_parameter_value(content)

    assert getattr(found, field) == content
    assert found.type != ParameterType.NOT_SET


@pytest.mark.parametrize("name", ALL_SERVICES)
def test_unreadable_request_gets_an_empty_response(network: Network, name: str) -> None:
    (payload,) = network.ask(b"\x00\x01", name)

    assert decode(ALL_SERVICES[name][1], payload) == ALL_SERVICES[name][1]()


def test_other_nodes_are_not_served(network: Network) -> None:
    request = encode(messages.ListParametersRequest(), Format.CDR)

    assert network.ask(request, "list_parameters", "/r2/agent") == []


def test_type_of_a_topic_is_described_by_the_fields_of_its_hash(network: Network) -> None:
    request = messages.GetTypeDescriptionRequest(ODOM.ros_type, hash_type(Odometry))

    response = network.call(request, messages.GetTypeDescriptionResponse)

    whole = response.type_description
    assert response.successful
    assert whole.type_description.type_name == ODOM.ros_type
    assert [one.name for one in whole.type_description.fields] == [
        name for name, _ in HUMBLE.get_msgdef(ODOM.ros_type).fields
    ]
    others = [one.type_name for one in whole.referenced_type_descriptions]
    assert others == sorted(others)
    assert "geometry_msgs/msg/PoseWithCovariance" in others


@pytest.mark.parametrize(
    ("ros_type", "type_hash"),
    [(ODOM.ros_type, "RIHS01_0"), ("std_msgs/msg/String", hash_type(Odometry))],
)
def test_unknown_type_is_refused_with_a_reason(
    network: Network, ros_type: str, type_hash: str
) -> None:
    request = messages.GetTypeDescriptionRequest(ros_type, type_hash)

    response = network.call(request, messages.GetTypeDescriptionResponse)

    assert (response.successful, bool(response.failure_reason)) == (False, True)


def test_each_node_of_a_large_fleet_announces_its_services(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ros_graph, "MAX_NODES_PER_ID", 2)
    network = Network(pattern="**/agent")
    robots = [network.graph.add_robot(f"r{number}", "agent") for number in range(2, 5)]
    for robot in robots:
        network.services.add(robot)

    for _ in range(4):
        network.services.poll()

    # The node has room for one robot beside r1; further ones are part of nodes that they share.
    shared = {one.shared.full_name for one in robots if one and one.shared}
    assert len(shared) == 2
    expected = {"/r1/agent", "/r2/agent", *shared}
    eventually(lambda: list_service_nodes(network) == expected, 5.0, "services of each node")
    request = encode(messages.ListParametersRequest(), Format.CDR)
    for name in (*shared, "/r4/agent"):
        assert len(network.ask(request, "list_parameters", name)) == 1


def list_service_nodes(network: Network) -> set[str]:
    """List the nodes of the graph that announce services."""
    sessions = (network.bus, *network.bus.opened_sessions)
    tokens = [token for session in sessions for token in session.list_tokens("@ros2_lv/**")]
    found = [parse_token(token) for token in tokens]
    return {
        qualify_name(one.node.namespace, one.node.name)
        for one in found
        if isinstance(one, GraphEndpoint) and one.kind == "SS"
    }


def test_humble_has_parameters_and_no_type_descriptions() -> None:
    network = Network(RosSettings(has_hashes=False))

    tokens = network.bus.list_tokens("@ros2_lv/**")

    assert len([one for one in tokens if "/SS/" in one]) == 6
    assert not [one for one in tokens if "RIHS01" in one]


def test_parameter_that_a_node_can_change_is_changed_or_refused_with_a_reason() -> None:
    network, values = Network(), dict[str, ParameterContent]()

    def change(name: str, content: ParameterContent) -> str | None:
        if not name.startswith("own."):
            return None
        values[name] = content
        return "" if content == "/r1/scan" else "no topic"

    node = network.graph.add_node("r2", "agent")
    network.services.add(node, NodeParameters(change=change))
    given = tuple(
        NamedParameter(name, make_parameter_value(value))
        for name, value in (("own.a", "/r1/scan"), ("own.b", 3), ("other", 1))
    )
    request = messages.SetParametersRequest(given)
    (payload,) = network.ask(encode(request, Format.CDR), "set_parameters", "/r2/agent")
    results = decode(messages.SetParametersResponse, payload).results

    assert [one.successful for one in results] == [True, False, False]
    assert results[1].reason == "no topic"
    assert values == {"own.a": "/r1/scan", "own.b": 3}


def test_only_one_parameter_is_changed_at_a_time_atomically() -> None:
    network, seen = Network(), list[str]()
    node = network.graph.add_node("r2", "agent")

    def change(name: str, content: ParameterContent) -> str:
        del content
        seen.append(name)
        return ""

    network.services.add(node, NodeParameters(change=change))
    given = [NamedParameter(name, make_parameter_value("/x")) for name in ("a", "b")]

    def set_all(*parameters: NamedParameter) -> bool:
        request = messages.SetParametersAtomicallyRequest(parameters)
        service = "set_parameters_atomically"
        (payload,) = network.ask(encode(request, Format.CDR), service, "/r2/agent")
        return decode(messages.SetParametersAtomicallyResponse, payload).result.successful

    assert not set_all(*given)
    assert set_all(given[0])
    assert seen == ["a"]


def test_services_are_served_through_bridges_if_asked() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings(is_bridged=True))
    services = NodeServices(bus, 0, is_bridged=True)
    services.add(graph.add_node("", "sim"))
    services.poll()
    bus.pumps.append(services.poll)

    request = encode(messages.GetParametersRequest(("use_sim_time",)), Format.CDR)
    (reply,) = bus.ask("sim/get_parameters", request, b"")

    (value,) = decode(messages.GetParametersResponse, reply.payload).values
    assert value.bool_value
    assert any(
        "@ros2_lv/SS/sim§get_parameters/" in one for one in bus.list_tokens("@/*/@ros2_lv/**")
    )
