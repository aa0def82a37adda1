"""ROS interface files (.msg, .srv, .action), written from the structs of zensim.

An independent implementation reads them and computes type hashes of its own. Packages that hiroz
brings along are not written: it has the definitions of ROS itself.
"""

from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path
from typing import cast

import msgspec
from msgspec import inspect

from zensim.proto.codec.cdr_layout import find_ros_class, unwrap_metadata
from zensim.proto.codec.message_codec import Format, supports_format
from zensim.proto.ros2.action_messages import SIMULATE_STEPS_ACTION
from zensim.proto.ros2.message_definitions import NAME_OF_CODE
from zensim.proto.ros2.ros_service_catalog import OWN_TYPE_PREFIX, ROS_SERVICES, V1_SERVICES
from zensim.proto.ros2.trajectory_messages import FOLLOW_JOINT_TRAJECTORY
from zensim.proto.topic_catalog import TOPICS, TopicScope

Struct = type[msgspec.Struct]
BUNDLED = (
    "action_msgs",
    "builtin_interfaces",
    "geometry_msgs",
    "nav_msgs",
    "rcl_interfaces",
    "rosgraph_msgs",
    "sensor_msgs",
    "service_msgs",
    "std_msgs",
    "std_srvs",
    "tf2_msgs",
    "trajectory_msgs",
    "type_description_interfaces",
    "unique_identifier_msgs",
)
"""Packages of hiroz-codegen 0.2.0 that the peers use."""
PARTS = {"srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
"""Endings of the messages of a service or action, in the order of its file."""


def write_interface_files(folder: Path) -> None:
    """Write `bundled.txt`, and a folder of packages for each version of the interfaces."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "bundled.txt").write_text("\n".join(BUNDLED) + "\n", encoding="utf-8")
    newest = [service for service in ROS_SERVICES if service not in V1_SERVICES]
    for version, services, others in (
        ("newest", newest, [*list_topic_messages(), *list_action_messages()]),
        ("v1", V1_SERVICES, []),
    ):
        halves = [half for one in services for half in (one.request, one.response)]
        write_packages(folder / version, [*halves, *others])


def list_topic_messages() -> Iterator[Struct]:
    """List the messages of all topics that have ROS 2 endpoints."""
    for topic in TOPICS.values():
        if topic.root_message is not None:
            yield topic.root_message
        if topic.scope is TopicScope.ROBOT:
            yield from topic.messages


def list_action_messages() -> Iterator[Struct]:
    """List the messages of all actions."""
    for kind in (SIMULATE_STEPS_ACTION, FOLLOW_JOINT_TRAJECTORY):
        yield from (*kind.send_goal, *kind.get_result, kind.feedback)


def write_packages(folder: Path, types: Iterable[Struct]) -> None:
    """Write the files of messages and of everything that they refer to."""
    definitions: dict[str, str] = {}
    for one in types:
        if supports_format(one, Format.CDR):
            _define(one, definitions)
    for name, text in _join_parts(definitions).items():
        package, kind, title = name.split("/")
        if package in BUNDLED or name.startswith(OWN_TYPE_PREFIX):
            continue
        path = folder / package / kind / f"{title}.{kind}"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text, encoding="utf-8")


def _define(message_type: Struct, definitions: dict[str, str]) -> str:
    """Add the definition of a message and of its nested messages; return its name."""
    named = find_ros_class(message_type)
    name = str(vars(named)["ros_type"])
    if name not in definitions:
        info = cast("inspect.StructType", inspect.type_info(named))
        lines = [f"{_write_type(field.type, definitions)} {field.name}\n" for field in info.fields]
        definitions[name] = "".join(lines)
    return name


def _write_type(info: inspect.Type, definitions: dict[str, str]) -> str:
    bare, extra = unwrap_metadata(info)
    if isinstance(bare, inspect.BytesType):
        return f"{NAME_OF_CODE[str(extra.get('cdr', 'B'))]}[]"
    if not isinstance(bare, inspect.VarTupleType):
        return _write_item(bare, extra, definitions)
    item, item_extra = unwrap_metadata(bare.item_type)
    length = extra.get("length", "")
    return f"{_write_item(item, extra | item_extra, definitions)}[{length}]"


def _write_item(info: inspect.Type, extra: dict[str, object], definitions: dict[str, str]) -> str:
    if isinstance(info, inspect.StructType):
        package, _, title = _define(info.cls, definitions).split("/")
        return f"{package}/{title}"
    if isinstance(info, inspect.StrType):
        return "string"
    if isinstance(info, inspect.BoolType):
        return "bool"
    return NAME_OF_CODE[str(extra.get("cdr", "d"))]


def _join_parts(definitions: dict[str, str]) -> dict[str, str]:
    """Join the parts of services and actions; drop messages that ROS derives from them."""
    joined = {name: text for name, text in definitions.items() if "/msg/" in name}
    for kind, endings in PARTS.items():
        heads = [one for one in definitions if f"/{kind}/" in one and one.endswith(endings[0])]
        for head in heads:
            name = head.removesuffix(endings[0])
            if all(name + ending in definitions for ending in endings):
                joined[name] = _join(definitions, name, endings)
    return joined


def _join(definitions: dict[str, str], name: str, endings: Sequence[str]) -> str:
    return "---\n".join(definitions[name + ending] for ending in endings)
