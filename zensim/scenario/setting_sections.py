"""Sections of scenario files whose keys are settings of programs."""

import re
from collections.abc import Iterator
from typing import Annotated, Any, Final, Literal, NamedTuple

import msgspec

from zensim.proto.settings.deployment_settings import UpSettings
from zensim.proto.settings.network_settings import NAME_PATTERN
from zensim.proto.settings.setting import SettingField, find_setting, list_settings
from zensim.scenario.quantities import described, quantity

SETTING: Final = re.compile(r"`(\w+)`")
"""A setting that a text names."""
Name = Annotated[str, msgspec.Meta(pattern=NAME_PATTERN, description="Letters, digits and _.")]
Selector = str | tuple[str, ...]
"""Names of robots: a name, a pattern with `*`, `?` or `[1-4]`, or a list of them."""
MAX_INTEGER: Final = (1 << 63) - 1
"""Greatest limit of an integer in JSON Schema as msgspec writes it."""


class SectionKey(NamedTuple):
    """A key of a section, as `msgspec.defstruct` takes it."""

    name: str
    kind: Any
    default: object


def list_keys(group: type[msgspec.Struct], section: str) -> Iterator[SectionKey]:
    """List the keys that the settings of a group are in a section of a scenario file."""
    for field in list_settings(group):
        of, _, name = field.setting.key.partition(".")
        if of == section:
            yield make_key(name, field)


def make_key(name: str, field: SettingField) -> SectionKey:
    """Make the key of a setting: numbers may be null, which is the default of programs."""
    setting = field.setting
    if setting.key_words is not None:
        words = _make_words(setting.key_words, setting.help)
        return SectionKey(name, words, setting.key_default)
    if field.choices:
        known = ("", *field.choices) if field.is_optional else field.choices
        default = "" if field.default is None else field.default
        text = f"{setting.help[:-1]}; empty = {setting.usual}." if "" in known else setting.help
        return SectionKey(name, _make_words(known, text), default)
    if field.is_path:
        text = f"{setting.help[:-1]}; empty = {setting.usual}."
        return SectionKey(name, Annotated[str, described(text)], "")
    if field.kind is float or field.is_optional:
        return SectionKey(name, Annotated[field.kind, _describe(field)] | None, None)
    return SectionKey(name, Annotated[field.kind, _describe(field)], field.default)


def _make_words(known: tuple[str, ...], summary: str) -> Any:  # noqa: ANN401
    kind: Any = Literal.__getitem__(known)
    return Annotated[kind, described(summary)]


def _describe(field: SettingField) -> msgspec.Meta:
    setting = field.setting
    none = "empty" if field.kind is str else "null"
    text = f"{setting.help[:-1]}; {none} = {setting.usual}." if setting.usual else setting.help
    text = SETTING.sub(_spell_key, text)
    if setting.unit:
        return quantity(setting.unit, text, at_least=setting.least, at_most=setting.most)
    if setting.pattern:
        return msgspec.Meta(description=text, pattern=setting.pattern)
    if field.kind is not int:
        return described(text)
    most = None if setting.most is None else min(int(setting.most), MAX_INTEGER)
    least = None if setting.least is None else int(setting.least)
    return msgspec.Meta(description=text, ge=least, le=most)


def _spell_key(found: re.Match[str]) -> str:
    key = find_setting(UpSettings, found[1]).setting.key
    return f"`{key.rpartition('.')[2]}`"


def make_section(name: str, summary: str, keys: list[SectionKey]) -> Any:  # noqa: ANN401
    """Make the type of a section from its keys."""
    return msgspec.defstruct(
        name,
        [tuple(one) for one in keys],
        frozen=True,
        forbid_unknown_fields=True,
        kw_only=True,
        module=__name__,
        namespace={"__doc__": summary},
    )


# Their types are made when this is imported, which mypy cannot see.
EngineSection: Any = make_section(
    "EngineSection", "The physics engine.", [*list_keys(UpSettings, "engine")]
)
TimeSection: Any = make_section(
    "TimeSection", "Time and random numbers.", [*list_keys(UpSettings, "time")]
)
WorldSection: Any = make_section("WorldSection", "The world.", [*list_keys(UpSettings, "world")])
NetworkSection: Any = make_section(
    "NetworkSection",
    "The Zenoh network and the server's process.",
    [
        *list_keys(UpSettings, "network"),
        SectionKey("verbose", Annotated[bool, described("Log at level INFO.")], default=False),
    ],
)
RosSection: Any = make_section(
    "RosSection", "Topics and services on the keys of ROS 2.", [*list_keys(UpSettings, "ros")]
)
ViewerSection: Any = make_section(
    "ViewerSection", "The page of `zensim up`.", [*list_keys(UpSettings, "viewer")]
)
SensorsSection: Any = make_section(
    "SensorsSection",
    "Processes that publish lidars and cameras.",
    [*list_keys(UpSettings, "sensors")],
)
AgentsSection: Any = make_section(
    "AgentsSection",
    "Processes that drive robots.",
    [
        SectionKey("name", Annotated[Name, described("Name of the agent.")], msgspec.NODEFAULT),
        SectionKey("drives", Annotated[Selector, described("Robots that it drives.")], "*"),
        SectionKey(
            "processes",
            Annotated[
                int, msgspec.Meta(ge=1, le=64, description="Number of processes; null = chosen.")
            ]
            | None,
            None,
        ),
        *list_keys(UpSettings, "agents[0]"),
    ],
)
