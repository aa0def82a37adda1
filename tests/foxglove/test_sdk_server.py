"""What a client gets from our server, and from that of Foxglove's SDK, for equal topics."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import foxglove
from foxglove.websocket import Capability
from websockets.sync.client import connect
from websockets.typing import Subprotocol

from tests.integration.processes import eventually
from zensim.foxglove.foxglove_protocol import (
    CONTROL_CAPABILITIES,
    SUBPROTOCOLS,
    WATCH_CAPABILITIES,
    Advertise,
    ServerInfo,
    encode_asset,
    encode_text,
    encode_time,
    frame_data,
    frame_message,
)
from zensim.foxglove.live_topics import LiveTopic
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.standard_messages import Header, Odometry, Time

WITHIN_S = 20.0
TIME_NS = 3_000_000_005
TOPIC = LiveTopic("/r1/odom", Odometry, ("r1/odom",))
PAYLOAD = encode(Odometry(Header(Time(3), "odom")), Format.CDR)
CAPABILITIES = [
    Capability.Time,
    Capability.ClientPublish,
    Capability.Parameters,
    Capability.Services,
]


class SdkServer:
    """A server of the SDK with one topic, and a client of it."""

    def __init__(self) -> None:
        self.context = foxglove.Context()
        given = TOPIC.to_channel(1)
        schema = foxglove.Schema(
            name=given.schema_name, encoding=given.schema_encoding, data=given.schema.encode()
        )
        self.channel = foxglove.Channel(
            TOPIC.name, message_encoding="cdr", schema=schema, context=self.context
        )
        self.server = foxglove.start_server(
            name="zensim w",
            port=0,
            capabilities=CAPABILITIES,
            supported_encodings=["cdr", "json"],
            asset_handler=lambda uri: b"mesh" if uri == "package://a/b.stl" else None,
            context=self.context,
            session_id="abc",
        )


@contextmanager
def running_sdk() -> Iterator[SdkServer]:
    server = SdkServer()
    try:
        yield server
    finally:
        server.server.stop()


def read_until(client: Any, accept: Any) -> Any:  # noqa: ANN401
    """Read messages until one is accepted."""
    while True:
        message = client.recv(WITHIN_S)
        value = json.loads(message) if isinstance(message, str) else message
        if accept(value):
            return value


def test_messages_equal_those_of_the_sdk() -> None:
    with (
        running_sdk() as sdk,
        connect(
            f"ws://127.0.0.1:{sdk.server.port}", subprotocols=[Subprotocol(SUBPROTOCOLS[0])]
        ) as client,
    ):
        info = read_until(client, lambda one: "op" in one and one["op"] == "serverInfo")
        advertised = read_until(client, lambda one: "op" in one and one["op"] == "advertise")
        number = advertised["channels"][0]["id"]
        subscription = {"id": 9, "channelId": number}
        client.send(json.dumps({"op": "subscribe", "subscriptions": [subscription]}))
        eventually(sdk.channel.has_sinks, WITHIN_S, "the subscription")
        sdk.channel.log(PAYLOAD, log_time=TIME_NS)
        data = read_until(client, lambda one: isinstance(one, bytes) and one[0] == 1)
        sdk.server.broadcast_time(TIME_NS)
        time = read_until(client, lambda one: isinstance(one, bytes) and one[0] == 2)
        client.send(json.dumps({"op": "fetchAsset", "uri": "package://a/b.stl", "requestId": 4}))
        asset = read_until(client, lambda one: isinstance(one, bytes) and one[0] == 4)

    ours = ServerInfo(
        "zensim w", (*WATCH_CAPABILITIES, *CONTROL_CAPABILITIES), ("cdr", "json"), {}, "abc"
    )
    our_info = json.loads(encode_text(ours))
    assert set(info.pop("capabilities")) == set(our_info.pop("capabilities"))
    assert {key: info[key] for key in our_info} == our_info
    our_channel = TOPIC.to_channel(number)
    assert advertised == json.loads(encode_text(Advertise((our_channel,))))
    assert frame_data(9, TIME_NS, PAYLOAD) == frame_message(data)
    assert encode_time(TIME_NS) == time
    assert encode_asset(4, b"mesh") == asset
