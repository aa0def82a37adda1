"""Each topic of the catalog has a schema, an echo type, rows in the documents and a publisher."""

import ast
import json

import msgspec
import pytest

from tests.contract.repository import ROOT, files, shown, text_of
from zensim.deploy.cli.topic_commands import to_plain
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.network_protocols import Sample
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.schema import SCHEMAS
from zensim.proto.topic_catalog import TOPICS, Participant, TopicScope, TopicSpec

PACKAGES = {
    Participant.SERVER: "sim_server/",
    Participant.AGENT: "robot_agent/",
    Participant.SENSORS: "sim_server/sensors/",
}
PLACEHOLDERS = {
    TopicScope.WORLD: ("<world>",),
    TopicScope.AGENT: ("<world>", "<agent>"),
    TopicScope.SENSORS: ("<world>", "<process>"),
    TopicScope.ROBOT: ("<ns>",),
}


def write_key_row(topic: TopicSpec) -> str:
    messages = " or ".join(kind.__name__ for kind in topic.messages)
    rate = f"{topic.rate_hz:g}" if topic.rate_hz else ""
    key = topic.key(*PLACEHOLDERS[topic.scope])
    return f"| `{key}` | {messages} | {topic.publisher.value} | {rate} | {topic.description} |"


def write_ros2_rows(topic: TopicSpec) -> list[str]:
    qos = f"{topic.qos.reliability.replace('_', ' ')}, {topic.qos.depth}"
    if topic.is_latched:
        qos = f"transient local, {topic.qos.depth}"
    rows = []
    if topic.scope is TopicScope.ROBOT:
        types = ", ".join(getattr(kind, "ros_type") for kind in topic.messages)  # noqa: B009
        rows.append(f"| `/NS/{topic.suffix}` | {types} | {qos} |")
    if topic.root_message is not None:
        rows.append(f"| `/{topic.suffix}` | {topic.root().ros_type} | {qos} |")
    return rows


def make_sample(key: str, kind: type[msgspec.Struct], format_: Format) -> Sample:
    message = make_sample_message(kind)
    # Bytes contain arrays whose length depends on other fields.
    is_array = [
        name for name in kind.__struct_fields__ if isinstance(getattr(message, name), bytes)
    ]
    message = msgspec.structs.replace(message, **dict.fromkeys(is_array, b""))
    return Sample(key, encode(message, format_), make_encoding(kind, format_))


@pytest.fixture(scope="module")
def imported_topics() -> dict[str, set[str]]:
    """List the topics that each package imports from the catalog, the innermost package only."""
    found: dict[str, set[str]] = {package: set() for package in PACKAGES.values()}
    innermost_first = sorted(found, key=len, reverse=True)
    for path in files():
        package = next((one for one in innermost_first if shown(path).startswith(one)), "")
        if package and path.suffix == ".py":
            for node in ast.walk(ast.parse(text_of(path))):
                if isinstance(node, ast.ImportFrom) and node.module == "zensim.proto.topic_catalog":
                    found[package] |= {alias.name.lower() for alias in node.names}
    return found


@pytest.mark.parametrize("topic", TOPICS.values(), ids=TOPICS)
def test_topic_is_in_the_committed_schemas(topic: TopicSpec) -> None:
    committed = json.loads(text_of(SCHEMAS / "keys.json"))["topics"]
    described = json.loads(text_of(SCHEMAS / "messages.json"))["$defs"]
    owner = {TopicScope.ROBOT: ("r1",), TopicScope.SENSORS: ("default", "sensors_1")}.get(
        topic.scope, ("default", "agent_1")
    )

    assert committed[topic.key(*owner)] == [kind.__name__ for kind in topic.messages]
    assert {kind.__name__ for kind in topic.messages} <= described.keys()


@pytest.mark.parametrize("topic", TOPICS.values(), ids=TOPICS)
def test_echo_decodes_each_message_of_a_topic(topic: TopicSpec) -> None:
    key = topic.key("r1", "agent_1")
    samples = [make_sample(key, kind, topic.format) for kind in topic.messages]
    if topic.root_message is not None:
        samples.append(make_sample(topic.suffix, topic.root_message, Format.CDR))

    assert all(isinstance(to_plain(sample), dict) for sample in samples)


@pytest.mark.parametrize("topic", TOPICS.values(), ids=TOPICS)
def test_page_of_keys_has_a_row_for_the_topic(topic: TopicSpec) -> None:
    assert write_key_row(topic) in text_of(ROOT / "docs" / "keys.md").splitlines()


@pytest.mark.parametrize("topic", TOPICS.values(), ids=TOPICS)
def test_ros2_page_has_the_rows_of_the_topic(topic: TopicSpec) -> None:
    rows = text_of(ROOT / "docs" / "ros2_interface.md").splitlines()

    assert [row for row in write_ros2_rows(topic) if row not in rows] == []


@pytest.mark.parametrize("topic", TOPICS.values(), ids=TOPICS)
def test_publisher_and_subscriber_use_the_topic(
    topic: TopicSpec, imported_topics: dict[str, set[str]]
) -> None:
    users = {topic.publisher, topic.subscriber} - {Participant.USER}

    assert [one.value for one in users if topic.name not in imported_topics[PACKAGES[one]]] == []
