"""Schemas of topics, as clients resolve them."""

import json
from typing import TYPE_CHECKING, Any

import pytest

from zensim.foxglove.live_topics import LiveTopic, list_live_topics
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.telemetry_messages import Event, Stats
from zensim.proto.topic_catalog import EVENTS, STATS, TopicSpec
from zensim.proto.topic_discovery import TopicFacts

if TYPE_CHECKING:
    import msgspec


def list_references(schema: Any) -> list[str]:  # noqa: ANN401
    if isinstance(schema, dict):
        own = [schema["$ref"]] if "$ref" in schema else []
        return own + [one for value in schema.values() for one in list_references(value)]
    if isinstance(schema, list):
        return [one for value in schema for one in list_references(value)]
    return []


def resolve(schema: dict[str, Any], root: dict[str, Any]) -> dict[str, Any]:
    if "$ref" not in schema:
        return schema
    found: Any = root
    for part in schema["$ref"].removeprefix("#/").split("/"):
        found = found[part]
    return resolve(found, root)


def check_types(schema: dict[str, Any], value: object, root: dict[str, Any]) -> None:
    """Check that each field of a message is in its schema, with a type."""
    schema = resolve(schema, root)
    kinds = {"object": dict, "array": list, "string": str, "boolean": bool}
    assert isinstance(value, kinds.get(schema["type"], (int, float)))
    if isinstance(value, dict):
        for name, part in value.items():
            check_types(schema["properties"][name], part, root)


@pytest.mark.parametrize("topic", [STATS, EVENTS], ids=lambda one: one.suffix)
def test_json_schema_describes_all_fields_of_a_message(topic: TopicSpec) -> None:
    kind: type[msgspec.Struct] = topic.messages[0]
    schema = json.loads(LiveTopic("/t", kind, ("t",), "json").to_channel(1).schema)

    message = Stats("w") if topic is STATS else Event("loaded")

    for reference in list_references(schema):
        assert resolve({"$ref": reference}, schema)
    assert schema["type"] == "object"
    check_types(schema, json.loads(encode(message, Format.JSON)), schema)


@pytest.mark.parametrize(
    "key",
    ["r1/front-scan", "r1/1scan", "r1//scan", "r1/*", "r1/**/scan", "r1/s can", "r1/" + "s" * 300],
)
def test_key_that_is_no_name_of_ros_is_no_topic(key: str) -> None:
    facts = [TopicFacts(one, "sensor_msgs/msg/LaserScan") for one in (key, "r1/scan")]

    listed = list_live_topics("w", facts, None)

    assert "/r1/scan" in listed
    assert f"/{key}" not in listed
