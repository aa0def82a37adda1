"""Topics of a network: those of the server, and those that programs announce as ROS 2 endpoints."""

from collections.abc import Iterable, Iterator

import msgspec

from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.proto.ros2.liveliness_tokens import TOKEN_SPACE, AnnouncedEndpoint, parse_endpoint_token
from zensim.proto.topic_catalog import (
    CMD_VEL,
    JOINT_STATES,
    ODOM,
    ROBOT_DESCRIPTION,
    ROBOT_TOPICS,
    TF,
    TF_STATIC,
    TOPICS,
    WORLD_TOPICS,
    Participant,
)

ANY_ENDPOINT = f"{TOKEN_SPACE}/**"
PUBLISHER, SUBSCRIPTION = "MP", "MS"
SERVER = "zensim server"


class TopicEndpoint(msgspec.Struct, frozen=True):
    """A publisher or subscription."""

    node: str
    ros_type: str
    reliability: str
    durability: str
    depth: int


class TopicFacts(msgspec.Struct, frozen=True):
    """A topic, and who publishes and subscribes."""

    key: str
    ros_type: str
    publishers: tuple[TopicEndpoint, ...] = ()
    subscriptions: tuple[TopicEndpoint, ...] = ()
    """Subscriptions of ROS 2 nodes and agents; plain Zenoh subscribers announce nothing."""


def list_topics(bus: Bus, world: str, models: GetModelsResponse | None) -> list[TopicFacts]:
    """List the topics of a world and of all robots on the network, by key.

    Args:
        bus: Open session.
        world: Its topics are listed if a server of it is running.
        models: Of the server; topics of robots that are not announced are derived from them.
    """
    announced = merge_endpoints(map(parse_endpoint_token, bus.list_tokens(ANY_ENDPOINT)))
    found = {one.key: one for one in announced}
    if bus.list_tokens(keys.alive_server(world)):
        found |= {one.key: one for one in list_world_topics(world)}
    for one in list_robot_topics(models) if models is not None else ():
        found.setdefault(one.key, one)
    return [found[key] for key in sorted(found)]


def merge_endpoints(endpoints: Iterable[AnnouncedEndpoint | None]) -> list[TopicFacts]:
    """Collect the endpoints of each topic; those of the root are no topics of plain Zenoh."""
    by_key: dict[str, list[AnnouncedEndpoint]] = {}
    for one in endpoints:
        if one is not None and one.kind in (PUBLISHER, SUBSCRIPTION) and "/" in one.key:
            by_key.setdefault(one.key, []).append(one)
    return [
        TopicFacts(
            key,
            ", ".join(dict.fromkeys(one.ros_type for one in ends)),
            tuple(_to_endpoint(one) for one in ends if one.kind == PUBLISHER),
            tuple(_to_endpoint(one) for one in ends if one.kind == SUBSCRIPTION),
        )
        for key, ends in by_key.items()
    ]


def _to_endpoint(one: AnnouncedEndpoint) -> TopicEndpoint:
    qos = one.qos
    return TopicEndpoint(one.node, one.ros_type, qos.reliability, qos.durability, qos.depth)


def list_world_topics(world: str) -> Iterator[TopicFacts]:
    """List what the server of a world publishes for users."""
    for topic in WORLD_TOPICS:
        if topic.publisher is Participant.SERVER and topic.subscriber is Participant.USER:
            name = topic.messages[0].__name__
            ros_type = str(getattr(topic.messages[0], "ros_type", "")) or f"zensim/msg/{name}"
            qos = topic.qos
            end = TopicEndpoint(SERVER, ros_type, qos.reliability, qos.durability, qos.depth)
            yield TopicFacts(topic.key(world), ros_type, (end,))


def list_robot_topics(models: GetModelsResponse) -> Iterator[TopicFacts]:
    """List the topics that robots with an agent have by their models."""
    for entity in models.entities:
        model = models.models[entity.model]
        if not entity.agent or not entity.namespace:
            continue
        driven = (CMD_VEL, ODOM, TF) if model.drive is not None else ()
        moving = (JOINT_STATES,) if any(joint.kind != "fixed" for joint in model.joints) else ()
        names = [topic.suffix for topic in (*driven, TF_STATIC, ROBOT_DESCRIPTION, *moving)]
        types = {name: ROBOT_TOPICS[name].messages[0] for name in names}
        types |= {
            one.name: TOPICS[one.topic].messages[0]
            for sensor in model.sensors
            for one in sensor.topics
            if one.topic in TOPICS
        }
        for name, kind in types.items():
            yield TopicFacts(keys.robot(entity.namespace, name), str(getattr(kind, "ros_type", "")))
