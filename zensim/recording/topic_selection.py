"""Which topics are recorded, and the key expressions to subscribe to for them."""

import re
from collections.abc import Iterable
from typing import Final

import msgspec

from zensim.proto import keys
from zensim.proto.messages.standard_messages import OccupancyGrid, String, UInt8MultiArray
from zensim.proto.ros2.liveliness_tokens import AnnouncedEndpoint
from zensim.proto.topic_catalog import (
    CLOCK,
    EVENTS,
    INPUTS,
    MAP,
    ROBOT_TOPICS,
    SNAPSHOT,
    STATS,
    WORLD_TOPICS,
    Participant,
    find_robot_topic,
)

CLOCK_TOPIC: Final = f"/{CLOCK.suffix}"
ROS_TYPE: Final = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Za-z0-9]+")
ANY_ROS_TYPE: Final = "*/*"
"""Type and type hash at the end of the keys of ROS 2."""
PUBLISHER: Final = "MP"
LATCHED_SUFFIXES: Final = tuple(
    one.suffix for one in (*WORLD_TOPICS, *ROBOT_TOPICS.values()) if one.is_latched
)
"""Suffixes of topics whose late subscribers get the last message."""
ROSTER_TOPICS: Final = (EVENTS, STATS, SNAPSHOT)
"""Topics of the world, recorded as texts with JSON."""


def name_requests_topic(world: str) -> str:
    """Name the topic with the requests that changed a world, which a recorder makes of its inputs.

    It has the first slash.
    """
    return f"/{INPUTS.key(world).removesuffix(INPUTS.suffix)}requests"


class TopicSelection(msgspec.Struct, frozen=True, kw_only=True):
    """Options that choose topics; names are those of ROS 2, with wildcards of Zenoh."""

    topics: tuple[str, ...] = ()
    """`/r1/odom`, `/*/odom`, `/**/scan`; the first slash may be left out."""
    wants_all: bool = False
    regex: str = ""
    """Topics whose name has a match anywhere."""
    exclude_regex: str = ""
    exclude_topics: tuple[str, ...] = ()
    types: tuple[str, ...] = ()
    """Topics of these types, `pkg/msg/Name`, whatever their names."""
    exclude_types: tuple[str, ...] = ()


class TopicFilter:
    """Decides by name and type."""

    def __init__(self, selection: TopicSelection) -> None:
        """Compile the expressions.

        Raises:
            ValueError: Nothing is selected, or an expression is not valid.
        """
        if not (selection.topics or selection.wants_all or selection.regex or selection.types):
            raise ValueError("no topics are selected; name some, or use `all` or `regex`")
        for one in (*selection.types, *selection.exclude_types):
            if not ROS_TYPE.fullmatch(one):
                raise ValueError(f"{one[:60]!r} is no type; use one such as nav_msgs/msg/Odometry")
        self._topics = tuple(one.strip("/") for one in selection.topics)
        self._wants_all = selection.wants_all
        self._regex = _compile("--regex", selection.regex)
        self._excluded = _compile("--exclude-regex", selection.exclude_regex)
        self._excluded_topics = tuple(one.strip("/") for one in selection.exclude_topics)
        self._types = frozenset(selection.types)
        self._excluded_types = frozenset(selection.exclude_types)
        self._is_by_name = selection.wants_all or bool(selection.regex)

    @property
    def topics(self) -> tuple[str, ...]:
        """The key expressions that were named."""
        return self._topics

    @property
    def is_broad(self) -> bool:
        """Whether topics are chosen among all."""
        return self._is_by_name or bool(self._types)

    def has_type(self, kinds: Iterable[type[msgspec.Struct]]) -> bool:
        """Whether a topic with one of these messages may be chosen among all."""
        return self._is_by_name or any(vars(one).get("ros_type") in self._types for one in kinds)

    def accepts(self, topic: str, ros_type: str | None = None) -> bool:
        """Whether a topic is recorded.

        Args:
            topic: Its name, with the first slash.
            ros_type: `pkg/msg/Name`; empty = unknown, None = any that would be accepted.
        """
        key = topic.strip("/")
        if ros_type in self._excluded_types:
            return False
        if self._excluded is not None and self._excluded.search(topic):
            return False
        if any(keys.intersect(one, key) for one in self._excluded_topics):
            return False
        if self._wants_all or any(keys.intersect(one, key) for one in self._topics):
            return True
        if self._types and (ros_type is None or ros_type in self._types):
            return True
        return self._regex is not None and self._regex.search(topic) is not None


def _compile(option: str, expression: str) -> "re.Pattern[str] | None":
    if not expression:
        return None
    try:
        return re.compile(expression)
    except re.error as error:
        raise ValueError(f"{option} {expression[:60]!r} is not valid: {error}") from error


def list_keys(chosen: TopicFilter, world: str, domain: int | None) -> list[str]:
    """List the key expressions of the selected topics, without the clock.

    They do not overlap, as a message would arrive once for each.

    Args:
        chosen: Decides which topics are recorded.
        world: Name of the world.
        domain: Of ROS 2; None = only plain keys.
    """
    listed = dict.fromkeys(
        key for topic in chosen.topics for key in _list_keys_of_topic(topic, world, domain)
    )
    if chosen.is_broad:
        listed.update(dict.fromkeys(_list_all_keys(chosen, world, domain)))
        types = {one.key(world): String.ros_type for one in ROSTER_TOPICS}
        types[INPUTS.key(world)] = UInt8MultiArray.ros_type
        types[MAP.suffix] = OccupancyGrid.ros_type
        listed.update(
            (key, None) for key, ros_type in types.items() if chosen.accepts(f"/{key}", ros_type)
        )
    inputs = INPUTS.key(world)
    if chosen.accepts(name_requests_topic(world), String.ros_type) and not any(
        keys.intersect(one, inputs) for one in listed
    ):
        listed[inputs] = None
    return _drop_covered(listed)


def _list_keys_of_topic(topic: str, world: str, domain: int | None) -> list[str]:
    if topic == CLOCK.suffix:
        return []
    spec = find_robot_topic(topic)
    is_ours = spec is not None and spec.publisher is not Participant.USER
    of_world = [one.key(world) for one in (*ROSTER_TOPICS, INPUTS)]
    if is_ours or topic in of_world or domain is None:
        return [topic]
    return [topic, f"{domain}/{topic}/{ANY_ROS_TYPE}"]


def _list_all_keys(chosen: TopicFilter, world: str, domain: int | None) -> list[str]:
    return [
        key
        for suffix, spec in ROBOT_TOPICS.items()
        if chosen.has_type(spec.messages)
        for key in _list_keys_of_topic(f"**/{suffix}", world, domain)
    ]


def _drop_covered(expressions: Iterable[str]) -> list[str]:
    """Leave out `**/depth/image_raw`, as `**/image_raw` covers it."""
    listed = list(expressions)
    return [
        one for one in listed if not any(other != one and _covers(other, one) for other in listed)
    ]


def _covers(wide: str, narrow: str) -> bool:
    if not wide.startswith("**/"):
        return False
    rest = wide.removeprefix("**/")
    is_same_end = narrow == rest or narrow.endswith(f"/{rest}")
    return "*" not in rest and is_same_end


def list_paced_topics(world: str) -> frozenset[str]:
    """List the topics of a world that are published by wall time, or name sessions."""
    paced = [one for one in WORLD_TOPICS if one.rate_hz or one is INPUTS]
    keys_of_world = [one.key(world) for one in paced]
    at_root = [one.suffix for one in paced if one.root_message is not None]
    named = {f"/{key}" for key in (*keys_of_world, *at_root)}
    return frozenset((*named, name_requests_topic(world)))


def list_ros_keys(
    chosen: TopicFilter, announced: Iterable[AnnouncedEndpoint], known: list[str], domain: int
) -> list[str]:
    """List the keys of announced publishers that the known key expressions do not cover.

    They are those of ROS 2 nodes, and topics that a description gives another name.
    """
    found: dict[str, None] = {}
    for one in announced:
        if one.kind != PUBLISHER or one.key == CLOCK.suffix or find_robot_topic(one.key):
            continue
        if not chosen.accepts(f"/{one.key}", one.ros_type):
            continue
        key = make_ros_key(one.key, domain)
        if not any(keys.intersect(_to_plain_key(other), one.key) for other in known):
            found[key] = None
    return list(found)


def make_ros_key(key: str, domain: int) -> str:
    """Write the key expression of a topic in ROS 2, of any type."""
    return f"{domain}/{key}/{ANY_ROS_TYPE}"


def _to_plain_key(expression: str) -> str:
    """Remove domain and type of a key expression of ROS 2."""
    if not expression.endswith(f"/{ANY_ROS_TYPE}"):
        return expression
    return expression.removesuffix(f"/{ANY_ROS_TYPE}").partition("/")[2]
