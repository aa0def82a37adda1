"""Bus features for ROS 2: attachments, timestamped replies on other keys, additional sessions."""

import json
from collections.abc import Iterator
from contextlib import closing
from typing import TYPE_CHECKING, Literal

import pytest
import zenoh
import zenoh.ext

from tests.integration.processes import eventually, free_endpoint
from tests.integration.rmw_sessions import open_rmw_session, subscribe_as_rmw
from tests.tcp_relay import TcpRelay
from zensim.proto import topic_endpoints
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, BusQuery, BusQueryQueue, open_bus
from zensim.proto.bus.zenoh_config import to_zenoh_json
from zensim.proto.messages.standard_messages import String
from zensim.proto.ros2.qos_profiles import LATCHED
from zensim.proto.ros2.ros_graph import RosGraph, RosTopic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.topic_endpoints import TopicFactory

if TYPE_CHECKING:
    from zensim.proto.network_protocols import Sample

KEY = "0/r1/tf_static/tf2_msgs::msg::dds_::TFMessage_/RIHS01_e369"
ATTACHMENT = b"a" * 33
DESCRIPTION = RosTopic("r1/robot_description", String, LATCHED)


@pytest.fixture
def router() -> Iterator[Bus]:
    with open_bus(BusConfig(mode="router", listen=(free_endpoint(),))) as bus:
        yield bus


@pytest.fixture
def client(router: Bus) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{router.endpoint}"]')
    with zenoh.open(config) as session:
        yield session


def one_call(queue: BusQueryQueue) -> BusQuery:
    found: list[BusQuery] = []

    def has_arrived() -> bool:
        found.extend(queue.take())
        return bool(found)

    eventually(has_arrived, 5.0, "being asked")
    return found[0]


def test_attachment_is_transmitted_with_its_sample(router: Bus) -> None:
    received = router.subscribe("r1/odom", depth=10)
    with router.open_session() as beside:
        publisher = beside.advertise("r1/odom", "")
        eventually(lambda: publisher.is_matched, 5.0, "matching")

        publisher.send(b"1", ATTACHMENT)
        publisher.send(b"2")

        samples: list[Sample] = []

        def have_arrived() -> bool:
            samples.extend(received.take())
            return len(samples) == 2

        eventually(have_arrived, 5.0, "arriving")
    assert [sample.attachment for sample in samples] == [ATTACHMENT, b""]


def test_opened_session_has_its_own_id(router: Bus) -> None:
    with router.open_session() as beside, beside.open_session() as another:
        assert len({router.zid, beside.zid, another.zid}) == 3


def test_late_joiner_receives_one_value_per_timestamp_on_its_key(
    router: Bus, client: zenoh.Session
) -> None:
    queue = router.serve(f"0/**/tf_static/*/*/@adv/pub/{router.zid}/1/_")
    got: list[zenoh.Sample] = []
    joiner = zenoh.ext.declare_advanced_subscriber(
        client, KEY, got.append, history=zenoh.ext.HistoryConfig(max_samples=1)
    )

    call = one_call(queue)
    stamp = router.stamp()
    call.add_reply(KEY, b"fixed", "", ATTACHMENT, stamp)
    call.add_reply(KEY, b"fixed", "", ATTACHMENT, stamp)
    call.drop()

    eventually(lambda: bool(got), 5.0, "the last value")
    publisher = router.advertise(KEY, "")
    publisher.send(b"fixed", ATTACHMENT, stamp)
    publisher.send(b"next", ATTACHMENT, router.stamp())
    eventually(lambda: len(got) > 1, 5.0, "the next value")
    joiner.undeclare()
    assert call.covers(f"{KEY}/@adv/pub/{router.zid}/1/_")
    assert [(str(s.key_expr), s.payload.to_bytes()) for s in got] == [
        (KEY, b"fixed"),
        (KEY, b"next"),
    ]
    assert got[0].attachment is not None
    assert got[0].attachment.to_bytes() == ATTACHMENT


def test_returning_subscriber_gets_what_changed_while_its_link_was_cut(
    router: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    # The message is repeated before the link is back.
    monkeypatch.setattr(topic_endpoints, "REPEAT_AFTER_S", 0.0)
    value = [b"old"]
    settings = RosSettings()
    node = RosGraph(router, settings).add_node("r1", "agent")
    publisher = TopicFactory(router, node, settings).publisher(DESCRIPTION)
    relay = TcpRelay(int(router.endpoint.rpartition(":")[2]))
    with (
        closing(relay),
        open_rmw_session(router.endpoint) as near,
        open_rmw_session(f"tcp/127.0.0.1:{relay.port}") as far,
    ):
        readers = []
        for session in (near, far):
            key = str(node.data_key(DESCRIPTION)) if node else ""
            readers.append(subscribe_as_rmw(session, key, depth=1, is_transient_local=True))

        def reads(index: int, wanted: bytes) -> bool:
            publisher.publish_to_new(lambda: value[0])
            publisher.reply_to_late_joiners(lambda: value[0])
            return [one.payload.to_bytes() for one in readers[index][0].queued()] == [wanted]

        eventually(lambda: reads(0, b"old") and reads(1, b"old"), 10.0, "the first value")
        relay.cut()
        value[0] = b"new"
        publisher.send(b"new")
        eventually(lambda: reads(0, b"new"), 10.0, "the change near by")
        assert reads(1, b"old")

        relay.reset()

        eventually(lambda: reads(1, b"new"), 20.0, "the change after the return")


@pytest.mark.parametrize(("mode", "lease_ms"), [("client", 2000), ("router", 10_000)])
def test_hosts_of_ros_may_stall_for_longer_than_agents(
    mode: Literal["client", "router"], lease_ms: int
) -> None:
    settings = json.loads(to_zenoh_json(BusConfig(mode=mode, connect=("tcp/127.0.0.1:1",))))

    assert settings["transport"]["link"]["tx"]["lease"] == lease_ms


def test_reply_on_an_unrequested_key_is_omitted(router: Bus, client: zenoh.Session) -> None:
    queue = router.serve("a")
    replies = client.get("a", zenoh.handlers.FifoChannel(4), timeout=60.0)

    call = one_call(queue)
    call.add_reply("b", b"other", "", ATTACHMENT, router.stamp())
    call.drop()

    assert [reply for reply in replies if reply.ok] == []


def test_reply_carries_an_attachment(router: Bus, client: zenoh.Session) -> None:
    queue = router.serve("a")
    replies = client.get("a", zenoh.handlers.FifoChannel(4), timeout=60.0)

    one_call(queue).reply(b"yes", "", attachment=ATTACHMENT)

    responses = [reply.ok for reply in replies if reply.ok]
    assert [bytes(response.attachment.to_bytes()) for response in responses] == [ATTACHMENT]
