"""Messages of the Foxglove WebSocket protocol: JSON texts, binary messages, websocket frames.

Source: the specification of subprotocol `foxglove.websocket.v1`; `foxglove.sdk.v1` is the same for
what is used here.
"""

import struct
from typing import Annotated, Final, Literal, TypeAlias

import msgspec

SUBPROTOCOLS: Final = ("foxglove.sdk.v1", "foxglove.websocket.v1")
"""Best first."""
ROS_SCHEMA: Final = "ros2msg"
MAX_UINT32: Final = (1 << 32) - 1

INFO, WARNING, ERROR = 0, 1, 2
"""Levels of a status."""
ParameterValue: TypeAlias = bool | int | float | str | list[bool | int | float | str] | None
_WRITE_TEXT: Final = msgspec.json.Encoder()
MAX_DETAIL: Final = 200
_CLIENT_DATA: Final = struct.Struct("<BI")
_CALL: Final = struct.Struct("<BIII")
_TIME: Final = struct.Struct("<BQ")
_DATA: Final = struct.Struct("<BIQ")
_ASSET: Final = struct.Struct("<BIBI")
CLIENT_DATA_OP, CALL_OP = 1, 2
DATA_OP, TIME_OP, RESPONSE_OP, ASSET_OP = 1, 2, 3, 4
# Websocket frames are written here, many at once: a call of the library for each costs ten times
# as much. Those of a server are not masked.
_TEXT_FRAME: Final = 0x81
_BINARY_FRAME: Final = 0x82
"""Final frames of messages."""
_SHORT, _MEDIUM = 126, 1 << 16
_MEDIUM_HEAD: Final = struct.Struct(">BBH")
_LONG_HEAD: Final = struct.Struct(">BBQ")
Capability = Literal["clientPublish", "parameters", "parametersSubscribe", "services"]
WATCH_CAPABILITIES: Final = ("time", "assets")
CONTROL_CAPABILITIES: Final[tuple[Capability, ...]] = (
    "clientPublish",
    "parameters",
    "parametersSubscribe",
    "services",
)
CONTROL_ENCODINGS: Final = ("cdr", "json")
"""Encodings of what clients publish and call, the preferred one first."""


class ServerMessage(msgspec.Struct, frozen=True, tag_field="op", rename="camel"):
    """A text that a server sends."""


class ServerInfo(ServerMessage, frozen=True, tag="serverInfo", omit_defaults=True):
    """The first message to each client."""

    name: str
    capabilities: tuple[str, ...]
    supported_encodings: tuple[str, ...] = ()
    metadata: dict[str, str] = {}
    session_id: str = ""


class AdvertisedChannel(msgspec.Struct, frozen=True, rename="camel"):
    """A topic that clients may subscribe to."""

    id: int
    topic: str
    encoding: str
    schema_name: str
    schema: str
    schema_encoding: str


class Advertise(ServerMessage, frozen=True, tag="advertise"):
    """New topics."""

    channels: tuple[AdvertisedChannel, ...]


class Unadvertise(ServerMessage, frozen=True, tag="unadvertise"):
    """Topics that are gone."""

    channel_ids: tuple[int, ...]


class Status(ServerMessage, frozen=True, tag="status", omit_defaults=True):
    """A text for users."""

    level: int
    message: str
    id: str = ""


class MessageForm(msgspec.Struct, frozen=True, rename="camel"):
    """Encoding and definition of the request or response of a service."""

    encoding: str
    schema_name: str
    schema_encoding: str
    schema: str


class AdvertisedService(msgspec.Struct, frozen=True):
    """A service that clients may call."""

    id: int
    name: str
    type: str
    request: MessageForm
    response: MessageForm


class AdvertiseServices(ServerMessage, frozen=True, tag="advertiseServices"):
    """New services."""

    services: tuple[AdvertisedService, ...]


class ServiceCallFailure(ServerMessage, frozen=True, tag="serviceCallFailure"):
    """A call without a response, and why."""

    service_id: int
    call_id: int
    message: str


class WorldParameter(msgspec.Struct, frozen=True, omit_defaults=True):
    """A parameter."""

    name: str
    value: ParameterValue = None
    type: str | None = None


class ParameterValues(ServerMessage, frozen=True, tag="parameterValues", omit_defaults=True):
    """Values that a client asked for, or that have changed."""

    parameters: tuple[WorldParameter, ...] = ()
    id: str | None = None


class ClientMessage(msgspec.Struct, frozen=True, tag_field="op", rename="camel"):
    """A text that a client sends."""


class ChannelSubscription(msgspec.Struct, frozen=True, rename="camel"):
    """A subscription, with an id that the client chose."""

    id: Annotated[int, msgspec.Meta(ge=0, le=MAX_UINT32)]
    channel_id: int


class Subscribe(ClientMessage, frozen=True, tag="subscribe"):
    """Subscribe to topics."""

    subscriptions: tuple[ChannelSubscription, ...]


class Unsubscribe(ClientMessage, frozen=True, tag="unsubscribe"):
    """End subscriptions."""

    subscription_ids: tuple[int, ...]


class ClientChannel(msgspec.Struct, frozen=True, rename="camel"):
    """A topic that a client advertises."""

    id: int
    topic: str
    encoding: str
    schema_name: str
    schema: str | None = None
    schema_encoding: str | None = None


class ClientAdvertise(ClientMessage, frozen=True, tag="advertise"):
    """Topics that a client advertises."""

    channels: tuple[ClientChannel, ...]


class ClientUnadvertise(ClientMessage, frozen=True, tag="unadvertise"):
    """Topics that a client publishes no more."""

    channel_ids: tuple[int, ...]


class GetParameters(ClientMessage, frozen=True, tag="getParameters"):
    """Ask for parameters; all if none is named."""

    parameter_names: tuple[str, ...] = ()
    id: str | None = None


class SetParameters(ClientMessage, frozen=True, tag="setParameters"):
    """Set parameters."""

    parameters: tuple[WorldParameter, ...] = ()
    id: str | None = None


class SubscribeParameterUpdates(ClientMessage, frozen=True, tag="subscribeParameterUpdates"):
    """Ask for each change of parameters; of all if none is named."""

    parameter_names: tuple[str, ...] = ()


class UnsubscribeParameterUpdates(ClientMessage, frozen=True, tag="unsubscribeParameterUpdates"):
    """End that; for all parameters if none is named."""

    parameter_names: tuple[str, ...] = ()


class FetchAsset(ClientMessage, frozen=True, tag="fetchAsset"):
    """Ask for a file."""

    uri: str
    request_id: int


class SubscribeConnectionGraph(ClientMessage, frozen=True, tag="subscribeConnectionGraph"):
    """Ask for publishers and subscribers of topics, which this server does not offer."""


class UnsubscribeConnectionGraph(ClientMessage, frozen=True, tag="unsubscribeConnectionGraph"):
    """End that."""


class ClientData(msgspec.Struct, frozen=True):
    """A message of a client on one of its topics."""

    channel_id: int
    payload: bytes


class ServiceCallRequest(msgspec.Struct, frozen=True):
    """A call of a service."""

    service_id: int
    call_id: int
    encoding: str
    payload: bytes


TextMessage: TypeAlias = (
    Subscribe
    | Unsubscribe
    | ClientAdvertise
    | ClientUnadvertise
    | GetParameters
    | SetParameters
    | SubscribeParameterUpdates
    | UnsubscribeParameterUpdates
    | FetchAsset
    | SubscribeConnectionGraph
    | UnsubscribeConnectionGraph
)
AnyClientMessage: TypeAlias = TextMessage | ClientData | ServiceCallRequest


class MalformedMessage(ValueError):
    """Bytes of a client that are no message of the protocol."""


_READ_TEXT: Final = msgspec.json.Decoder(TextMessage)


def decode_client_message(raw: str | bytes) -> AnyClientMessage:
    """Decode a message of a client.

    Raises:
        MalformedMessage: It is none.
    """
    try:
        return _READ_TEXT.decode(raw) if isinstance(raw, str) else _decode_binary(raw)
    except (msgspec.DecodeError, RecursionError, UnicodeError, struct.error) as error:
        detail = " ".join(str(error).split())[:MAX_DETAIL]
        raise MalformedMessage(f"no message of the protocol: {detail}") from error


def _decode_binary(raw: bytes) -> ClientData | ServiceCallRequest:
    op = raw[0] if raw else 0
    if op == CLIENT_DATA_OP:
        _, channel = _CLIENT_DATA.unpack_from(raw)
        return ClientData(channel, raw[_CLIENT_DATA.size :])
    if op != CALL_OP:
        raise MalformedMessage(f"binary message with opcode {op}; use 1 or 2")
    _, service, call, length = _CALL.unpack_from(raw)
    start = _CALL.size + length
    if start > len(raw):
        raise MalformedMessage(f"encoding of {length} bytes in a message of {len(raw)}")
    return ServiceCallRequest(service, call, raw[_CALL.size : start].decode(), raw[start:])


def encode_text(message: ServerMessage) -> str:
    """Encode a text of the server."""
    return _WRITE_TEXT.encode(message).decode()


def encode_time(time_ns: int) -> bytes:
    """Encode the time of the server [ns]."""
    return _TIME.pack(TIME_OP, time_ns)


def encode_response(call: ServiceCallRequest, payload: bytes) -> bytes:
    """Encode the response to a call."""
    encoding = call.encoding.encode()
    head = _CALL.pack(RESPONSE_OP, call.service_id, call.call_id, len(encoding))
    return head + encoding + payload


def encode_asset(request_id: int, content: bytes | None, error: str = "") -> bytes:
    """Encode a file, or the reason why there is none."""
    reason = error.encode() if content is None else b""
    status = int(content is None)
    return _ASSET.pack(ASSET_OP, request_id & MAX_UINT32, status, len(reason)) + (
        reason if content is None else content
    )


def frame_data(subscription: int, time_ns: int, payload: bytes) -> bytes:
    """Make the websocket frame of a message on a topic.

    Args:
        subscription: Its id.
        time_ns: Time of the message [ns].
        payload: As its encoding says.
    """
    head = _make_frame_head(_BINARY_FRAME, _DATA.size + len(payload))
    return head + _DATA.pack(DATA_OP, subscription, time_ns) + payload


def frame_message(message: str | bytes) -> bytes:
    """Make the websocket frame of a text or binary message."""
    kind, content = (
        (_TEXT_FRAME, message.encode()) if isinstance(message, str) else (_BINARY_FRAME, message)
    )
    return _make_frame_head(kind, len(content)) + content


def _make_frame_head(kind: int, size: int) -> bytes:
    if size < _SHORT:
        return bytes((kind, size))
    if size < _MEDIUM:
        return _MEDIUM_HEAD.pack(kind, _SHORT, size)
    return _LONG_HEAD.pack(kind, _SHORT + 1, size)
