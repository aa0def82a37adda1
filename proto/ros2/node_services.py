"""Services that each ROS 2 node has: its parameters, and descriptions of the types it uses."""

import time
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Final, TypeAlias

import msgspec

from zensim.proto.codec.message_codec import Format, MalformedPayload, decode, encode
from zensim.proto.network_protocols import Query, QueryQueue, TopicNetwork
from zensim.proto.ros2 import node_messages as messages
from zensim.proto.ros2.liveliness_tokens import Qos
from zensim.proto.ros2.node_messages import (
    PARAMETER_SERVICES,
    TYPE_SERVICES,
    ParameterDescriptor,
    ParameterType,
    ParameterValue,
    SetParameterResult,
)
from zensim.proto.ros2.rmw_attachment import answer_attachment
from zensim.proto.ros2.rmw_keys import NO_HASH, parse_data_key
from zensim.proto.ros2.ros_graph import RosNode
from zensim.proto.ros2.type_hash import describe_type, find_service_type, hash_service

CDR_ENCODING: Final = str(Format.CDR.value)
PARAMETERS_QOS: Final = Qos(depth=1000)
"""Profile `rmw_qos_profile_parameters`."""
MAX_ANNOUNCED_AT_ONCE: Final = 2
"""Nodes whose services are announced in one call: 14 tokens, about a millisecond."""
NODE_QUERY_DEPTH: Final = 1024
SEPARATOR: Final = "."
ParameterContent: TypeAlias = bool | int | float | str | tuple[str, ...] | tuple[float, ...]
FIELD_OF_TYPE: Final = {
    ParameterType.BOOL: "bool_value",
    ParameterType.INTEGER: "integer_value",
    ParameterType.DOUBLE: "double_value",
    ParameterType.STRING: "string_value",
    ParameterType.DOUBLE_ARRAY: "double_array_value",
    ParameterType.STRING_ARRAY: "string_array_value",
}


class NodeParameter(msgspec.Struct, frozen=True):
    """A parameter of a node; none can be changed by its services."""

    name: str
    """Parts are separated by dots."""
    value: ParameterContent
    description: str = ""
    reason: str = "it is fixed while the program runs"
    """Why it cannot be set."""


USE_SIM_TIME: Final = NodeParameter(
    "use_sim_time",
    value=True,
    description="Stamps are simulation time, as on /clock.",
    reason="all stamps of a simulator are simulation time",
)
"""Parameter of every node."""
ListParameters: TypeAlias = Callable[[], Sequence[NodeParameter]]


def find_parameter_type(content: ParameterContent) -> ParameterType:
    """Find the type of a value."""
    if isinstance(content, bool):
        return ParameterType.BOOL
    if isinstance(content, tuple):
        is_text = all(isinstance(one, str) for one in content)
        return ParameterType.STRING_ARRAY if is_text else ParameterType.DOUBLE_ARRAY
    if isinstance(content, str):
        return ParameterType.STRING
    return ParameterType.INTEGER if isinstance(content, int) else ParameterType.DOUBLE


def make_parameter_value(content: ParameterContent) -> ParameterValue:
    """Write a value as ROS 2 does."""
    kind = find_parameter_type(content)
    return msgspec.structs.replace(ParameterValue(type=int(kind)), **{FIELD_OF_TYPE[kind]: content})


def list_names(
    names: Sequence[str], request: messages.ListParametersRequest
) -> messages.ListParametersResult:
    """List the names below any of the prefixes, down to the depth.

    Source: rclcpp, NodeParameters::list_parameters.
    """
    found = [name for name in names if _is_listed(name, request)]
    prefixes = {name.rpartition(SEPARATOR)[0] for name in found} - {""}
    return messages.ListParametersResult(tuple(found), tuple(sorted(prefixes)))


def _is_listed(name: str, request: messages.ListParametersRequest) -> bool:
    if not request.prefixes:
        return not request.depth or name.count(SEPARATOR) < request.depth
    for prefix in request.prefixes:
        rest = name.removeprefix(f"{prefix}{SEPARATOR}")
        if name == prefix or (
            rest != name and (not request.depth or rest.count(SEPARATOR) < request.depth)
        ):
            return True
    return False


class ParameterServer:
    """Replies of one node to requests about its parameters."""

    __slots__ = ("_list_parameters",)

    def __init__(self, list_parameters: ListParameters) -> None:
        self._list_parameters = list_parameters

    def reply(self, request: msgspec.Struct) -> msgspec.Struct:
        """Find the response to a request of `PARAMETER_SERVICES`."""
        known = {one.name: one for one in (USE_SIM_TIME, *self._list_parameters())}
        match request:
            case messages.ListParametersRequest():
                return messages.ListParametersResponse(list_names(sorted(known), request))
            case messages.GetParametersRequest(names=names):
                return messages.GetParametersResponse(
                    tuple(_find_value(known.get(name)) for name in names)
                )
            case messages.GetParameterTypesRequest(names=names):
                return messages.GetParameterTypesResponse(
                    tuple(_find_value(known.get(name)).type for name in names)
                )
            case messages.DescribeParametersRequest(names=names):
                return messages.DescribeParametersResponse(
                    tuple(_describe(name, known.get(name)) for name in names)
                )
        return _refuse_changes(request, known)


def _find_value(parameter: NodeParameter | None) -> ParameterValue:
    return ParameterValue() if parameter is None else make_parameter_value(parameter.value)


def _describe(name: str, parameter: NodeParameter | None) -> ParameterDescriptor:
    if parameter is None:
        return ParameterDescriptor(name)
    return ParameterDescriptor(
        name,
        int(find_parameter_type(parameter.value)),
        parameter.description,
        f"read-only: {parameter.reason}",
        read_only=True,
    )


def _refuse_changes(request: msgspec.Struct, known: dict[str, NodeParameter]) -> msgspec.Struct:
    """Refuse to set parameters, unless to the values that they have."""
    if isinstance(request, messages.SetParametersRequest):
        results = tuple(_check_change(one, known) for one in request.parameters)
        return messages.SetParametersResponse(results)
    assert isinstance(request, messages.SetParametersAtomicallyRequest)
    results = tuple(_check_change(one, known) for one in request.parameters)
    refused = next((one for one in results if not one.successful), None)
    return messages.SetParametersAtomicallyResponse(refused or SetParameterResult(successful=True))


def _check_change(
    wanted: messages.NamedParameter, known: dict[str, NodeParameter]
) -> SetParameterResult:
    parameter = known.get(wanted.name)
    if parameter is None:
        return SetParameterResult(reason=f"no parameter {wanted.name[:64]!r}; see list_parameters")
    if wanted.value == make_parameter_value(parameter.value):
        return SetParameterResult(successful=True)
    return SetParameterResult(reason=f"parameter '{wanted.name}' is read-only: {parameter.reason}")


class TypeDescriptions:
    """Descriptions of the messages that a process uses in ROS 2, by type and hash."""

    def __init__(self, kinds: dict[str, type[msgspec.Struct]]) -> None:
        """Take the messages by type hash."""
        self._kinds = kinds

    def reply(self, request: messages.GetTypeDescriptionRequest) -> msgspec.Struct:
        """Describe a type; its source is not text, so there is none.

        Source: REP 2016.
        """
        kind = self._kinds.get(request.type_hash)
        if kind is None or (whole := describe_type(kind))["type_description"]["type_name"] != (
            request.type_name
        ):
            return messages.GetTypeDescriptionResponse(
                failure_reason=f"this node does not use {request.type_name[:64]!r} with that hash"
            )
        source = messages.TypeSource(request.type_name, "dynamic")
        return messages.GetTypeDescriptionResponse(
            successful=True,
            type_description=msgspec.convert(whole, messages.WholeTypeDescription),
            type_sources=(source,) if request.include_type_sources else (),
        )


@dataclass(frozen=True, slots=True)
class _ServedNode:
    node: RosNode
    parameters: ParameterServer
    queue: QueryQueue | None
    """None where the pattern includes the node."""


class NodeServices:
    """Parameter services and type descriptions of the nodes of one process."""

    def __init__(self, network: TopicNetwork, domain: int | None, pattern: str = "") -> None:
        """Serve no node yet.

        Args:
            network: Session of the queryables.
            domain: Of ROS 2; None = nothing is served.
            pattern: Names that all nodes match, such as `**/agent`, so that one queryable serves
                all; empty for a queryable a node.
        """
        self._network = network
        self._domain = domain
        self._served: dict[str, _ServedNode] = {}
        self._unannounced: deque[RosNode] = deque()
        has_pattern = bool(pattern) and domain is not None
        self._shared = self._serve(pattern) if has_pattern else None

    def add(self, node: RosNode | None, list_parameters: ListParameters = tuple) -> None:
        """Serve a node; it is announced later. None is ignored."""
        if node is None or not node.graph.settings.has_node_services:
            return
        queue = self._serve(node.full_name.strip("/")) if self._shared is None else None
        self._served[node.full_name] = _ServedNode(node, ParameterServer(list_parameters), queue)
        node.on_close = partial(self._remove, node)
        if node.shared is None:
            self._unannounced.append(node)
        elif node.shared.full_name not in self._served:
            self.add(node.shared)

    def _remove(self, node: RosNode) -> None:
        """Serve a node no longer; it undeclares its tokens itself."""
        if (served := self._served.pop(node.full_name, None)) is None:
            return
        if served.queue is not None:
            served.queue.close()
        if node in self._unannounced:
            self._unannounced.remove(node)

    def poll(self) -> None:
        """Reply to all queued requests, and announce some nodes."""
        for _ in range(min(MAX_ANNOUNCED_AT_ONCE, len(self._unannounced))):
            announce_node_services(self._unannounced.popleft())
        for queue in self._list_queues():
            for query in queue.take():
                self._reply(query)

    def close(self) -> None:
        """Undeclare the queryables."""
        for served in tuple(self._served.values()):
            self._remove(served.node)
        if self._shared is not None:
            self._shared.close()

    def _list_queues(self) -> list[QueryQueue]:
        if self._shared is not None:
            return [self._shared]
        return [one.queue for one in self._served.values() if one.queue is not None]

    def _serve(self, name: str) -> QueryQueue:
        return self._network.serve(f"{self._domain}/{name}/*/*/*", NODE_QUERY_DEPTH)

    def _reply(self, query: Query) -> None:
        key = parse_data_key(query.key)
        node_name, _, service = key.name.rpartition("/") if key else ("", "", "")
        served, kinds = self._served.get(node_name), ALL_SERVICES.get(service)
        if served is None or kinds is None:
            query.drop()
            return
        response = self._find_response(served, kinds, query)
        attachment = answer_attachment(query.request_id, time.time_ns())
        query.reply(encode(response, Format.CDR), CDR_ENCODING, attachment=attachment)

    def _find_response(
        self, served: _ServedNode, kinds: tuple[type[Any], type[Any]], query: Query
    ) -> msgspec.Struct:
        try:
            request: msgspec.Struct = decode(kinds[0], query.payload, CDR_ENCODING)
        except MalformedPayload:
            # A client of rmw_zenoh would wait for ever.
            empty: msgspec.Struct = kinds[1]()
            return empty
        if isinstance(request, messages.GetTypeDescriptionRequest):
            return TypeDescriptions(served.node.graph.kinds).reply(request)
        return served.parameters.reply(request)


ALL_SERVICES: Final = PARAMETER_SERVICES | TYPE_SERVICES


def announce_node_services(node: RosNode) -> None:
    """Announce the services of a node; bridges do not need them."""
    has_hashes = node.graph.settings.has_hashes
    for name, (request, response) in (ALL_SERVICES if has_hashes else PARAMETER_SERVICES).items():
        node.add_endpoint(
            "SS",
            f"{node.full_name}/{name}",
            find_service_type(request),
            type_hash=hash_service(request, response) if has_hashes else NO_HASH,
            qos=PARAMETERS_QOS,
            bridge_key=None,
        )
