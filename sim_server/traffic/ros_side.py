"""The server's side of ROS 2: its node, services, action and topics."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, Protocol

from zensim.proto.bus import Bus
from zensim.proto.messages.simulation_messages import StepsProgress
from zensim.proto.ros2 import action_messages as action
from zensim.proto.ros2.rmw_keys import ANY_HASH, NO_HASH, make_data_key
from zensim.proto.ros2.ros_graph import RosGraph, RosNode, Topic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.ros2.type_hash import find_service_type, hash_service
from zensim.proto.topic_endpoints import TopicFactory, TopicPublisher
from zensim.sim_server.traffic.calls import Call
from zensim.sim_server.traffic.ros_action import Query, StepsAction
from zensim.sim_server.traffic.ros_calls import announce_services, bridge_calls, rmw_calls

NODE: Final = "zensim"
"""What the server is called in ROS 2."""


class Source(Protocol):
    """Where requests come from."""

    def take(self) -> Sequence[Call]:
        """Take what has come."""


class Queue(Protocol):
    """Requests on a key expression."""

    def take(self) -> Sequence[Query]:
        """Take what has come."""


@dataclass(frozen=True)
class Queues:
    """Requests on several keys, as if on one."""

    queues: tuple[Queue, ...]

    def take(self) -> list[Query]:
        """Take what has come, queue by queue."""
        return [query for queue in self.queues for query in queue.take()]


@dataclass(frozen=True)
class RosSide:
    """What the loop's inbox and outlet need of it.

    Attributes:
        heed: Hears of the progress of steps.
        close: Withdraws everything.
    """

    sources: tuple[Source, ...]
    faces: TopicFactory
    heed: Callable[[StepsProgress], None]
    close: Callable[[], None]


def ros_side(bus: Bus, settings: RosSettings) -> RosSide:
    """Show the server to ROS 2, as far as the settings want it."""
    graph = RosGraph(bus, settings)
    node = graph.node("", NODE)
    faces = TopicFactory(bus, node, settings)
    if node is None:
        return RosSide((), faces, lambda _: None, graph.close)
    announce_services(node)
    steps = _steps_action(bus, node, faces)
    sources: tuple[Source, ...] = (rmw_calls(bus, node.domain), steps)
    if settings.is_bridged:
        sources = (*sources, bridge_calls(bus))
    return RosSide(sources, faces, steps.note, graph.close)


def _steps_action(bus: Bus, node: RosNode, faces: TopicFactory) -> StepsAction:
    settings = node.graph.settings
    node.announce_action(action.ACTION_NAME, action.ACTION_TYPE)
    queues = {}
    for name, (request, response) in action.ACTION_SERVICES.items():
        kind = find_service_type(request)
        type_hash = hash_service(request, response) if settings.has_hashes else NO_HASH
        node.join("SS", name, kind, type_hash=type_hash)
        keys = [make_data_key(node.domain, name, kind, ANY_HASH)]
        if settings.is_bridged:
            keys.append(name.strip("/"))
        queues[name] = Queues(tuple(bus.serve(key) for key in keys))
    tellers: dict[str, TopicPublisher] = {
        name: faces.publisher(Topic(name.strip("/"), kind, is_latched=name == action.STATUS_TOPIC))
        for name, kind in action.ACTION_TOPICS.items()
    }
    return StepsAction(queues, tellers)
