"""Which topics of a recording are replayed, and under which names."""

from collections.abc import Iterable
from typing import Final

import msgspec

from zensim.proto.names import check_name, check_namespace, is_topic_name
from zensim.recording.recording_reader import StoredTopic
from zensim.recording.topic_selection import CLOCK_TOPIC, ROSTER_TOPICS, TopicFilter, TopicSelection

WORLD_PART: Final = "sim"
REPLAYED_WORLD_TOPICS: Final = frozenset(one.suffix for one in ROSTER_TOPICS)
"""Others of a world are for programs, and take effect there."""
RULE: Final = ":="


class NameSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Options that choose and rename topics."""

    selection: TopicSelection
    """Nothing named = all."""
    remaps: tuple[str, ...] = ()
    """`/old:=/new`, of a topic or of all topics below a name."""
    namespace: str = ""
    """Put before all names; empty = none."""
    world: str = ""
    """World of clock and events on the network; empty = as recorded, or the namespace."""


class ReplayedNames:
    """The key of each topic of a recording that is replayed."""

    def __init__(self, settings: NameSettings, topics: Iterable[StoredTopic]) -> None:
        """Choose and rename.

        Raises:
            ValueError: A rule, a name or an expression is not valid, or no topic is chosen.
        """
        self._rules = dict(map(_parse_rule, settings.remaps))
        self.unused_rules = set(self._rules)
        """What rules rename, if no chosen topic begins with it."""
        self._namespace = check_namespace(settings.namespace) if settings.namespace else ""
        chosen = _make_filter(settings.selection)
        listed, self.left_out = _split_names(topics)
        """Names that are not of topics; these are not replayed."""
        recorded = next((_find_world(one.name) for one in listed if _find_world(one.name)), "")
        self.world = settings.world or self._namespace.replace("/", "_") or recorded or "default"
        """Name of the world on the network."""
        check_name(self.world, "world name")
        self.keys = {
            one: key
            for one in listed
            if chosen.accepts(one.name) and (key := self._find_key(one.name))
        }
        """Key of each topic."""
        if not self.keys:
            raise ValueError("no topic of the recording is chosen; 'zensim bag info' lists them")
        self.clock_key = self._rename(CLOCK_TOPIC).strip("/")
        """Key of `/clock`, whose time is that of the replay."""

    def accepts(self, topic: StoredTopic) -> bool:
        """Whether a topic is replayed."""
        return topic in self.keys

    def _find_key(self, name: str) -> str:
        """Find the key of a topic; empty if it is not replayed."""
        if name == CLOCK_TOPIC:
            return ""
        parts = name.strip("/").split("/", 2)
        if parts[0] == WORLD_PART:
            suffix = parts[-1]
            return f"sim/{self.world}/{suffix}" if suffix in REPLAYED_WORLD_TOPICS else ""
        return self._rename(name).strip("/")

    def _rename(self, name: str) -> str:
        parts = name.strip("/").split("/")
        for count in range(len(parts), 0, -1):
            new = self._rules.get("/".join(parts[:count]))
            if new is not None:
                self.unused_rules.discard("/".join(parts[:count]))
                parts[:count] = [new]
                break
        return "/".join(filter(None, (self._namespace, *parts)))


def is_world_topic(key: str) -> bool:
    """Whether a key is of a world, not of a robot."""
    return key.startswith(f"{WORLD_PART}/")


def _find_world(name: str) -> str:
    """Find the world of a topic such as `/sim/default/events`; empty for others."""
    match name.strip("/").split("/", 2):
        case [first, world, _] if first == WORLD_PART:
            return world
    return ""


def _split_names(topics: Iterable[StoredTopic]) -> tuple[list[StoredTopic], tuple[str, ...]]:
    """Split off the names that cannot be: a file may have any text there."""
    listed, left_out = [], []
    for one in topics:
        if is_topic_name(one.name):
            listed.append(one)
        else:
            left_out.append(one.name)
    return listed, tuple(left_out)


def _make_filter(selection: TopicSelection) -> TopicFilter:
    is_named = bool(selection.topics or selection.regex)
    return TopicFilter(msgspec.structs.replace(selection, wants_all=not is_named))


def _parse_rule(text: str) -> tuple[str, str]:
    old, separator, new = text.partition(RULE)
    names = [part.strip().strip("/") for part in (old, new)]
    if not separator or not all(names):
        raise ValueError(f"`remap` {text[:60]!r} is not valid; use /old:=/new")
    for name in names:
        check_namespace(name)
    return names[0], names[1]
