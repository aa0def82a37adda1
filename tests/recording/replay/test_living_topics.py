"""A replay is refused on keys on which others publish."""

from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.standard_messages import Odometry
from zensim.proto.messages.telemetry_messages import EntityModel, GetModelsResponse
from zensim.proto.ros2.ros_graph import RosGraph, RosTopic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.recording.replay.living_topics import TopicsInUse, require_unused

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus

KEYS = ("r1/odom", "team/r2/odom", "clock")


def serve_world(bus: MemoryBus, name: str, *namespaces: str) -> None:
    """Serve a world with these robots."""
    bus.token(keys.alive_server(name))
    queue = bus.serve(keys.service(name, "get_models"))
    entities = tuple(EntityModel(one, one, 0) for one in namespaces)
    response = GetModelsResponse(entities=entities)

    def reply() -> None:
        for call in queue.take():
            call.reply(encode(response, Format.MSGPACK), make_encoding(response, Format.MSGPACK))

    bus.pumps.append(reply)


def test_quiet_network_admits_a_replay() -> None:
    bus = MemoryBus()

    require_unused(cast("Bus", bus), KEYS, "default", 0)


@pytest.mark.parametrize("namespace", ["r1", "team/r2"])
def test_namespace_of_a_living_robot_is_named(namespace: str) -> None:
    bus = MemoryBus()
    serve_world(bus, "other", namespace, "r3")

    with pytest.raises(TopicsInUse, match=f"'{namespace}'.*--namespace"):
        require_unused(cast("Bus", bus), ["r1/odom", "team/r2/odom"], "default", 0)


def test_clock_of_another_world_and_a_world_of_this_name_are_refused() -> None:
    bus = MemoryBus()
    serve_world(bus, "other")

    with pytest.raises(TopicsInUse, match="clock"):
        require_unused(cast("Bus", bus), KEYS, "default", 0)
    with pytest.raises(TopicsInUse, match="running"):
        require_unused(cast("Bus", bus), ["x/odom", "sim/other/clock"], "other", 0)
    require_unused(cast("Bus", bus), ["x/odom"], "other", 0)
    require_unused(cast("Bus", bus), ["replay/clock", "replay/r1/odom"], "replay", 0)


def test_second_replay_of_a_world_is_refused() -> None:
    bus = MemoryBus()
    bus.token(keys.alive_replay("default"))

    with pytest.raises(TopicsInUse, match="replayed"):
        require_unused(cast("Bus", bus), KEYS, "default", None)


def test_topic_of_a_node_of_ros_2_is_refused_in_its_domain() -> None:
    bus = MemoryBus()
    graph = RosGraph(bus, RosSettings(domain=4))
    node = graph.add_node("r1", "base")
    assert node is not None
    node.add_topic_endpoint("MP", RosTopic("r1/odom", Odometry))

    with pytest.raises(TopicsInUse, match="/r1/base"):
        require_unused(cast("Bus", bus), KEYS, "default", 4)
    require_unused(cast("Bus", bus), KEYS, "default", 5)
