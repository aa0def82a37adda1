"""Topics that clients may subscribe to: of the world, and of its robots. Pure."""

from collections.abc import Iterable, Iterator, Mapping
from functools import cache
from typing import Any, Final, Literal

import msgspec

from zensim.foxglove.foxglove_protocol import ROS_SCHEMA, AdvertisedChannel
from zensim.foxglove.scene_messages import SceneUpdate
from zensim.proto.messages.standard_messages import Clock, OccupancyGrid, TFMessage
from zensim.proto.names import is_topic_name
from zensim.proto.ros2.message_definitions import write_definition
from zensim.proto.schema import list_cdr_types
from zensim.proto.topic_catalog import (
    CLOCK,
    EVENTS,
    MAP,
    STATS,
    TF,
    TF_STATIC,
    Participant,
    TopicSpec,
    find_robot_topic,
)
from zensim.proto.topic_discovery import TopicFacts

TopicContent = Literal["messages", "latched", "tf", "tf_static", "scene", "clock", "json"]
SCENE_TOPIC: Final = "/zensim/scene"
ANY_ROS_TYPE: Final = "*/*"
"""Type and type hash at the end of the keys of ROS 2."""
WORLD_PREFIX: Final = "sim/"
REFERENCE_PREFIX: Final = "#/$defs/"
KIND_OF_TYPE: Final[Mapping[str, type[msgspec.Struct]]] = list_cdr_types()


class LiveTopic(msgspec.Struct, frozen=True):
    """A topic, and where its messages are."""

    name: str
    """Name as ROS 2 writes it, with a leading slash."""
    kind: type[msgspec.Struct]
    keys: tuple[str, ...]
    """Key expressions of its messages."""
    content: TopicContent = "messages"

    def to_channel(self, number: int) -> AdvertisedChannel:
        """Describe it to clients."""
        if self.content == "json":
            name = f"zensim.{self.kind.__name__}"
            schema = _write_json_schema(self.kind)
            return AdvertisedChannel(number, self.name, "json", name, schema, "jsonschema")
        ros_type = str(vars(self.kind)["ros_type"])
        definition = write_definition(self.kind)
        return AdvertisedChannel(number, self.name, "cdr", ros_type, definition, ROS_SCHEMA)


def list_live_topics(
    world: str, facts: Iterable[TopicFacts], domain: int | None
) -> dict[str, LiveTopic]:
    """List the topics of a world and of robots, by name.

    Args:
        world: Its name.
        facts: What robots have.
        domain: Of ROS 2, whose nodes publish commands; None = without them.
    """
    found = {one.name: one for one in _list_world_topics(world)}
    for fact in facts:
        topic = _make_robot_topic(fact, domain)
        if topic is not None:
            found.setdefault(topic.name, topic)
    return found


def _list_world_topics(world: str) -> Iterator[LiveTopic]:
    yield LiveTopic(f"/{TF.suffix}", TFMessage, (TF.suffix,), "tf")
    yield LiveTopic(f"/{TF_STATIC.suffix}", TFMessage, (TF_STATIC.suffix,), "tf_static")
    yield LiveTopic(f"/{CLOCK.suffix}", Clock, (), "clock")
    yield LiveTopic(f"/{MAP.suffix}", OccupancyGrid, (MAP.suffix,), "latched")
    yield LiveTopic(SCENE_TOPIC, SceneUpdate, (), "scene")
    for spec in (STATS, EVENTS):
        yield LiveTopic(f"/{spec.key(world)}", spec.messages[0], (spec.key(world),), "json")


def _make_robot_topic(fact: TopicFacts, domain: int | None) -> LiveTopic | None:
    """Make the topic of a robot; None if ROS 2 has no such name or type, or it is merged in /tf."""
    spec = find_robot_topic(fact.key)
    is_of_robot = is_topic_name(fact.key) and not fact.key.startswith(WORLD_PREFIX)
    if not is_of_robot or spec in (TF, TF_STATIC):
        return None
    kinds = (one.strip() for one in fact.ros_type.split(","))
    kind = next((found for one in kinds if (found := KIND_OF_TYPE.get(one)) is not None), None)
    if kind is None:
        return None
    content: TopicContent = "latched" if spec is not None and spec.is_latched else "messages"
    return LiveTopic(f"/{fact.key}", kind, _list_keys(fact.key, spec, domain), content)


def _list_keys(key: str, spec: TopicSpec | None, domain: int | None) -> tuple[str, ...]:
    is_ours = spec is not None and spec.publisher is not Participant.USER
    return (key,) if is_ours or domain is None else (key, f"{domain}/{key}/{ANY_ROS_TYPE}")


@cache
def _write_json_schema(kind: type[msgspec.Struct]) -> str:
    """Write a JSON Schema whose root is the message itself, as readers of topics expect."""
    _, components = msgspec.json.schema_components([kind])
    return msgspec.json.encode(_inline(components[kind.__name__], components)).decode()


def _inline(schema: Any, components: Mapping[str, Any]) -> Any:  # noqa: ANN401
    """Put referred types in place, and give a type to enumerated texts: clients resolve neither."""
    if isinstance(schema, list):
        return [_inline(one, components) for one in schema]
    if not isinstance(schema, dict):
        return schema
    if (reference := schema.get("$ref")) is not None:
        return _inline(components[reference.removeprefix(REFERENCE_PREFIX)], components)
    found = {name: _inline(value, components) for name, value in schema.items()}
    values = found.get("enum")
    if values and all(isinstance(one, str) for one in values):
        found.setdefault("type", "string")
    return found
