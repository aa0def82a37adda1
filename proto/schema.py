"""Writes and checks the description of the wire: schemas, services, keys, codes, golden bytes."""

import inspect
import json
import sys
from enum import IntEnum
from functools import cache
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import TypeVar

import msgspec

from zensim.proto import keys, messages
from zensim.proto.codec.message_codec import Format, encode, make_encoding, supports_format
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.service_catalog import SERVICES
from zensim.proto.topic_catalog import DRIVE_COMMAND, TOPICS, TopicScope, TopicSpec

Kind = TypeVar("Kind")

SCHEMAS = Path(__file__).parent / "schemas"
MESSAGE_MODULES: tuple[ModuleType, ...] = tuple(
    import_module(f"{messages.__name__}.{one.name}") for one in iter_modules(messages.__path__)
)
KEY_ARGUMENTS = {
    "world": "default",
    "agent": "agent_1",
    "process": "sensors_1",
    "name": "spawn_entity",
    "namespace": "r1",
    "topic": "odom",
}


def list_messages() -> dict[str, type[msgspec.Struct]]:
    """List the public messages by name."""
    return {kind.__name__: kind for kind in _find_defined(msgspec.Struct)}


def list_cdr_types() -> dict[str, type[msgspec.Struct]]:
    """List the messages with a ROS type that CDR can express, by that type."""
    return {
        kind.ros_type: kind
        for kind in list_messages().values()
        if hasattr(kind, "ros_type") and supports_format(kind, Format.CDR)
    }


@cache
def find_cdr_type(ros_type: str) -> type[msgspec.Struct] | None:
    """Find the message of a ROS type, if CDR can express it; to try all takes a while."""
    named = [kind for kind in _list_all() if getattr(kind, "ros_type", "") == ros_type]
    return next((kind for kind in reversed(named) if supports_format(kind, Format.CDR)), None)


@cache
def _list_all() -> tuple[type[msgspec.Struct], ...]:
    return tuple(list_messages().values())


def list_top_level_types() -> list[type[msgspec.Struct]]:
    """List the messages of topics and the requests and responses of services."""
    on_topics = {kind for topic in TOPICS.values() for kind in topic.messages}
    in_services = {kind for one in SERVICES.values() for kind in (one.request, one.response)}
    return sorted(on_topics | in_services, key=lambda kind: kind.__name__)


def make_artefacts() -> dict[str, str]:
    """Write the text of each file, by name."""
    contents = {
        "messages.json": make_message_schemas(),
        "services.json": list_services(),
        "keys.json": list_keys(),
        "codes.json": list_codes(),
        "golden.json": make_golden(),
    }
    return {
        name: json.dumps(content, indent=1, ensure_ascii=False) + "\n"
        for name, content in contents.items()
    }


def make_message_schemas() -> dict[str, object]:
    """Describe every message by JSON Schema, with properties in the order of CDR."""
    kinds = list_messages()
    _, described = msgspec.json.schema_components(kinds.values())
    for name, kind in kinds.items():
        if hasattr(kind, "ros_type"):
            described[name]["x-ros-type"] = kind.ros_type
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$defs": dict(sorted(described.items())),
    }


def list_services() -> dict[str, object]:
    """List key, messages, codes and formats of each service."""
    return {
        name: {
            "key": keys.service("default", name),
            "request": service.request.__name__,
            "response": service.response.__name__,
            "codes": [family.__name__ for family in (ResultCode, service.codes) if [*family]],
            "formats": _list_formats(service.request, service.response),
        }
        for name, service in sorted(SERVICES.items())
    }


def list_keys() -> dict[str, object]:
    """Write each key expression with example arguments, and the messages of each topic."""
    world, namespace = KEY_ARGUMENTS["world"], KEY_ARGUMENTS["namespace"]
    examples = {
        "drive_commands": DRIVE_COMMAND.key(world, "*"),
        "robot_topics": keys.robot(namespace, "*"),
    }
    for topic in TOPICS.values():
        if topic.scope is not TopicScope.ROBOT:
            examples[topic.name] = _make_example_key(topic)
    for name, function in vars(keys).items():
        if inspect.isfunction(function):
            wanted = inspect.signature(function).parameters
            if set(wanted) <= set(KEY_ARGUMENTS):
                examples[name] = function(**{given: KEY_ARGUMENTS[given] for given in wanted})
    on_topics = {
        _make_example_key(topic): [kind.__name__ for kind in topic.messages]
        for topic in TOPICS.values()
    }
    return {
        "arguments": KEY_ARGUMENTS,
        "keys": dict(sorted(examples.items())),
        "topics": dict(sorted(on_topics.items())),
    }


def _make_example_key(topic: TopicSpec) -> str:
    if topic.scope is TopicScope.ROBOT:
        return topic.key(KEY_ARGUMENTS["namespace"])
    owner = "process" if topic.scope is TopicScope.SENSORS else "agent"
    return topic.key(KEY_ARGUMENTS["world"], KEY_ARGUMENTS[owner])


def list_codes() -> dict[str, object]:
    """List the members of each enumeration."""
    return {
        family.__name__: {member.name: member.value for member in family}
        for family in _find_defined(IntEnum)
    }


def make_golden() -> dict[str, object]:
    """Encode one sample of each top-level type: CDR and MessagePack as hex, JSON as text."""
    return {kind.__name__: _encode_sample(kind) for kind in list_top_level_types()}


def _encode_sample(kind: type[msgspec.Struct]) -> dict[str, str]:
    example = make_sample_message(kind)
    written = (
        {"encoding": make_encoding(kind, Format.CDR)} if supports_format(kind, Format.CDR) else {}
    )
    for name in _list_formats(kind):
        payload = encode(example, Format[name])
        written[name] = payload.decode() if name == Format.JSON.name else payload.hex()
    return written


def _list_formats(*kinds: type[msgspec.Struct]) -> list[str]:
    return [
        format_.name for format_ in Format if all(supports_format(kind, format_) for kind in kinds)
    ]


def _find_defined(parent: type[Kind]) -> list[type[Kind]]:
    """List the subclasses in the message modules, by name."""
    found = [
        member
        for module in MESSAGE_MODULES
        for member in vars(module).values()
        if isinstance(member, type)
        and issubclass(member, parent)
        and member.__module__ == module.__name__
    ]
    return sorted(found, key=lambda kind: kind.__name__)


def find_stale(folder: Path = SCHEMAS) -> list[str]:
    """List the committed files that differ from the types."""
    wanted = make_artefacts()
    present = {path.name for path in folder.glob("*.json")}
    return sorted(
        name
        for name in wanted.keys() | present
        if name not in present
        or name not in wanted
        or (folder / name).read_text(encoding="utf-8") != wanted[name]
    )


def write(folder: Path = SCHEMAS) -> None:
    """Write all files."""
    folder.mkdir(exist_ok=True)
    for name, text in make_artefacts().items():
        (folder / name).write_text(text, encoding="utf-8")


def main(arguments: list[str], folder: Path = SCHEMAS) -> int:
    """Write the artefacts, or compare them with `--check`.

    Returns:
        0; 1 when committed files differ; 2 for other arguments.
    """
    if not arguments:
        write(folder)
        return 0
    if arguments != ["--check"]:
        sys.stdout.write(f"unknown arguments: {' '.join(arguments)}; use --check or none\n")
        return 2
    stale = find_stale(folder)
    for name in stale:
        sys.stdout.write(f"{name} is stale; run 'python -m zensim.proto.schema'\n")
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
