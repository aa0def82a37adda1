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
from zensim.proto.ros2.node_messages import (
    PARAMETER_SERVICES,
    TYPE_SERVICES,
    ParameterDescriptor,
    ParameterType,
    ParameterValue,
    SetParameterResult,
)
from zensim.proto.ros2.qos_profiles import Qos
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
    """A parameter of a node; its services change it if the node says how."""

    name: str
    """Parts are separated by dots."""
    value: ParameterContent
    description: str = ""
    reason: str = "it is fixed while the program runs"
    """Why it cannot be set; empty if it can."""


USE_SIM_TIME: Final = NodeParameter(
    "use_sim_time",
    value=True,
    description="Stamps are simulation time, as on /clock.",
    reason="all stamps of a simulator are simulation time",
)
"""Parameter of every node."""
Known: TypeAlias = dict[str, NodeParameter]
ListParameters: TypeAlias = Callable[[], Sequence[NodeParameter]]
ChangeParameter: TypeAlias = Callable[[str, ParameterContent], str | None]
"""Changes a parameter, which may be new: returns why it is refused, empty if it is done, or None if
there is no such parameter that can be changed."""


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


def read_parameter_value(value: ParameterValue) -> ParameterContent | None:
    """Read a value; None if there is none, or one of a type that no parameter has."""
    kind = next((one for one in FIELD_OF_TYPE if one == value.type), None)
    content: ParameterContent | None = getattr(value, FIELD_OF_TYPE[kind]) if kind else None
    return content


@dataclass(frozen=True)
class NodeParameters:
    """The parameters of a node, and how its services change them."""

    list_all: ListParameters = tuple
    change: ChangeParameter = lambda _name, _content: None


class ParameterServer:
    """Replies of one node to requests about its parameters."""

    __slots__ = ("_parameters",)

    def __init__(self, parameters: NodeParameters) -> None:
        self._parameters = parameters

    def reply(self, request: msgspec.Struct) -> msgspec.Struct:
        """Find the response to a request of `PARAMETER_SERVICES`."""
        known = {one.name: one for one in (USE_SIM_TIME, *self._parameters.list_all())}
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
        if isinstance(request, messages.SetParametersRequest):
            results = tuple(self._set(one, known) for one in request.parameters)
            return messages.SetParametersResponse(results)
        assert isinstance(request, messages.SetParametersAtomicallyRequest)
        return messages.SetParametersAtomicallyResponse(self._set_all(request.parameters, known))

    def _set(self, wanted: messages.NamedParameter, known: Known) -> SetParameterResult:
        if (content := read_parameter_value(wanted.value)) is not None:
            reason = self._parameters.change(wanted.name, content)
            if reason is not None:
                return SetParameterResult(successful=not reason, reason=reason)
        return _check_change(wanted, known)

    def _set_all(
        self, parameters: Sequence[messages.NamedParameter], known: Known
    ) -> SetParameterResult:
        """Set one parameter; several are refused unless all have their values already."""
        if len(parameters) == 1:
            return self._set(parameters[0], known)
        results = (_check_change(one, known) for one in parameters)
        refused = next((one for one in results if not one.successful), None)
        return refused or SetParameterResult(successful=True)


def _find_value(parameter: NodeParameter | None) -> ParameterValue:
    return ParameterValue() if parameter is None else make_parameter_value(parameter.value)


def _describe(name: str, parameter: NodeParameter | None) -> ParameterDescriptor:
    if parameter is None:
        return ParameterDescriptor(name)
    return ParameterDescriptor(
        name,
        int(find_parameter_type(parameter.value)),
        parameter.description,
        f"read-only: {parameter.reason}" if parameter.reason else "",
        read_only=bool(parameter.reason),
    )


def _check_change(wanted: messages.NamedParameter, known: Known) -> SetParameterResult:
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
    queues: tuple[QueryQueue, ...]
    """Empty where the pattern includes the node."""


class NodeServices:
    """Parameter services and type descriptions of the nodes of one process."""

    def __init__(
        self,
        network: TopicNetwork,
        domain: int | None,
        pattern: str = "",
        *,
        is_bridged: bool = False,
    ) -> None:
        """Serve no node yet.

        Args:
            network: Session of the queryables.
            domain: Of ROS 2; None = nothing is served.
            pattern: Names that all nodes match, such as `**/agent`, so that one queryable serves
                all; empty for a queryable a node.
            is_bridged: Whether nodes that have own queryables are served through bridges, too.
        """
        self._network = network
        self._domain, self._is_bridged = domain, is_bridged
        self._served: dict[str, _ServedNode] = {}
        self._unannounced: deque[RosNode] = deque()
        has_pattern = bool(pattern) and domain is not None
        self._shared = self._serve(pattern) if has_pattern else None

    def add(self, node: RosNode | None, parameters: NodeParameters | None = None) -> None:
        """Serve a node; it is announced later. None is ignored."""
        if node is None or not node.graph.settings.has_node_services:
            return
        queues = () if self._shared else self._serve_node(node.full_name.strip("/"))
        self._served[node.full_name] = _ServedNode(
            node, ParameterServer(parameters or NodeParameters()), queues
        )
        node.on_close = partial(self._remove, node)
        if node.shared is None:
            self._unannounced.append(node)
        elif node.shared.full_name not in self._served:
            self.add(node.shared)

    def _remove(self, node: RosNode) -> None:
        """Serve a node no longer; it undeclares its tokens itself."""
        if (served := self._served.pop(node.full_name, None)) is None:
            return
        for queue in served.queues:
            queue.close()
        if node in self._unannounced:
            self._unannounced.remove(node)

    def poll(self) -> None:
        """Reply to all queued requests, and announce some nodes."""
        for _ in range(min(MAX_ANNOUNCED_AT_ONCE, len(self._unannounced))):
            announce_node_services(self._unannounced.popleft(), is_bridged=self._is_bridged)
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
        return [queue for one in self._served.values() for queue in one.queues]

    def _serve(self, name: str) -> QueryQueue:
        return self._network.serve(f"{self._domain}/{name}/*/*/*", NODE_QUERY_DEPTH)

    def _serve_node(self, name: str) -> tuple[QueryQueue, ...]:
        own = self._serve(name)
        return (own, self._network.serve(f"{name}/*")) if self._is_bridged else (own,)

    def _reply(self, query: Query) -> None:
        key = parse_data_key(query.key)
        # Bridges have neither domain nor type in their keys.
        node_name, _, service = (key.name if key else f"/{query.key}").rpartition("/")
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


def announce_node_services(node: RosNode, *, is_bridged: bool = False) -> None:
    """Announce the services of a node, to bridges if they are served there."""
    has_hashes = node.graph.settings.has_hashes
    for name, (request, response) in (ALL_SERVICES if has_hashes else PARAMETER_SERVICES).items():
        node.add_endpoint(
            "SS",
            f"{node.full_name}/{name}",
            find_service_type(request),
            type_hash=hash_service(request, response) if has_hashes else NO_HASH,
            qos=PARAMETERS_QOS,
            bridge_key="" if is_bridged else None,
        )
