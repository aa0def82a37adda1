"""Tags of one plug-in, also in older spellings, and its <ros> block."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from zensim.proto.messages.drive_messages import RosBlock
from zensim.proto.names import InvalidName, check_namespace
from zensim.sim_server.description.element_rules import (
    ElementRule,
    check_element,
    make_leaves,
    make_unread,
)
from zensim.sim_server.description.strict_parsing import parse_flag, read_number, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Vec3
    from zensim.sim_server.description.report import ParseReport

_NO_NODE = "there is no ROS node to pass it to"
ROS_RULE = ElementRule(
    children=make_leaves("namespace", "remapping")
    | make_unread(_NO_NODE, "argument", "parameter")
    | make_unread("quality of service is fixed", "qos"),
    many=("namespace", "remapping"),
)
"""A <ros> block."""
NOT_A_NUMBER = (".nan", "nan")
"""Spellings of an unset number in YAML."""
_PATH_ENDS = re.compile("[/@]")
PLUGIN_ATTRIBUTES = ("name", "filename")


def read_ros_block(ros: Element, *, subject: str, report: ParseReport) -> RosBlock:
    """Read a <ros> block; unusable tags are reported and left out."""
    namespaces: list[str] = []
    remappings: list[str] = []
    for child in ros:
        text = (child.text or "").strip()
        if child.tag == "namespace":
            namespaces.append(text)
        elif child.tag == "remapping":
            remappings += _read_remapping(text, subject=subject, report=report)
    check_element(ros, ROS_RULE, f"{subject}, ros", report)
    namespace = _read_namespace(namespaces, subject=subject, report=report)
    return RosBlock(namespace=namespace, remappings=tuple(remappings))


def _read_remapping(text: str, *, subject: str, report: ParseReport) -> list[str]:
    """Accept a rule whose target is a valid ROS name."""
    old, separator, new = (part.strip() for part in text.partition(":="))
    if not (old and separator and new):
        report.suspicious(f"{subject}: <remapping>", f"{text[:80]!r} is not 'from:=to'")
        return []
    try:
        # The robot's namespace makes a relative name absolute.
        check_namespace(new if new.startswith("/") else f"robot/{new}")
    except InvalidName:
        report.suspicious(
            f"{subject}: <remapping>",
            f"{new[:80]!r} is not a ROS topic, such as 'team/odom'; not used",
        )
        return []
    return [text]


def _read_namespace(written: list[str], *, subject: str, report: ParseReport) -> str:
    if len(written) > 1:
        report.suspicious(
            f"{subject}: <namespace>", f"given {len(written)} times; the first is used"
        )
    text = written[0].strip("/") if written else ""
    if not text:
        return ""
    try:
        return check_namespace(text)
    except InvalidName as error:
        report.suspicious(f"{subject}: <namespace>", f"{error}; not used")
        return ""


class WrittenTags(NamedTuple):
    """Tags of a plug-in or parameters of a controller, as written."""

    subject: str
    """Subject of the entries of the report."""
    filename: str
    """File name of the plug-in, or type of the controller."""
    texts: Sequence[tuple[str, str]]
    """Names and values in order; a list is a name several times."""
    ros: Element | None = None
    is_xml: bool = False
    bare: Sequence[str] = ()
    """Paths of elements without text, and of attributes as PATH@NAME: most are of no reader."""


def list_plugin_tags(plugin: Element) -> WrittenTags:
    """List the tags of a plug-in."""
    bare = [f"@{name}" for name in plugin.attrib if name not in PLUGIN_ATTRIBUTES]
    for child in plugin:
        bare += () if child.tag == "ros" else list_bare(child, child.tag)
    return WrittenTags(
        f"plugin {(plugin.get('name') or '')[:80]!r}",
        plugin.get("filename") or "",
        [(child.tag, (child.text or "").strip()) for child in plugin],
        plugin.find("ros"),
        is_xml=True,
        bare=bare,
    )


def list_bare(element: Element, path: str) -> Iterator[str]:
    """List the attributes of an element, and all below it."""
    yield from (f"{path}@{name}" for name in element.attrib)
    for child in element:
        yield f"{path}/{child.tag}"
        yield from list_bare(child, f"{path}/{child.tag}")


class PluginTags:
    """Tags by name; each reading method marks its tag as read.

    Args:
        written: The tags.
        slug: First half of the errors' slugs, such as `drive`.
        aliases: Tags by older spelling.
        report: Gets what is unusual.
    """

    def __init__(
        self, written: WrittenTags, *, slug: str, aliases: Mapping[str, str], report: ParseReport
    ) -> None:
        self.subject = written.subject
        self.filename = written.filename
        self.report = report
        self._slug = slug
        self._ros = written.ros
        self._is_xml = written.is_xml
        self._texts: dict[str, list[str]] = {}
        self._renamed: set[str] = set()
        self._read = {"ros"}
        self._bare = written.bare
        self._aliases = aliases
        for name, text in written.texts:
            tag = aliases.get(name, name)
            if tag != name:
                self._renamed.add(tag)
                if self._is_xml:
                    report.suspicious(self.label(name), f"spelling of ROS 1; read as <{tag}>")
            self._texts.setdefault(tag, []).append(text)

    def label(self, tag: str) -> str:
        """Name a tag in the report."""
        return f"{self.subject}: <{tag}>" if self._is_xml else f"{self.subject}: {tag}"

    def names(self) -> tuple[str, ...]:
        """List the tags that are there."""
        return tuple(self._texts)

    def is_renamed(self, tag: str) -> bool:
        """Whether the tag is present in an older spelling."""
        return tag in self._renamed

    def texts(self, tag: str) -> list[str]:
        """Read a repeatable tag."""
        self._read.add(tag)
        return self._texts.get(tag, [])

    def text(self, tag: str, default: str) -> str:
        """Read the first tag; empty gives the default."""
        written = self.texts(tag)
        if len(written) > 1:
            self.report.suspicious(
                self.label(tag), f"given {len(written)} times; the first is used"
            )
        return (written[0] if written else "") or default

    def number(self, tag: str, default: float) -> float:
        """Read a number >= 0.

        Raises:
            ModelError: It is not.
        """
        number = self._parse_number(tag, self.text(tag, repr(default)))
        if number < 0.0:
            raise self._make_error(tag, f"{number:g} is negative; write a number >= 0")
        return number

    def signed(self, tag: str) -> float | None:
        """Read a number of either sign; None without the tag or for NaN.

        Raises:
            ModelError: It is not a number.
        """
        text = self.text(tag, "")
        if text.lower() in NOT_A_NUMBER:
            return None
        return self._parse_number(tag, text) if text else None

    def is_true(self, tag: str) -> bool:
        """Whether the tag is there and true; it is not marked as read."""
        return any(parse_flag(text) for text in self._texts.get(tag, ()))

    def has(self, tag: str) -> bool:
        """Whether the tag is there."""
        return tag in self._texts

    def numbers(self, tag: str) -> list[float]:
        """Read the numbers of a repeatable tag, of either sign.

        Raises:
            ModelError: One is not a number.
        """
        return [self._parse_number(tag, text) for text in self.texts(tag)]

    def vector(self, tag: str) -> Vec3:
        """Read three numbers; 0 0 0 without the tag.

        Raises:
            ModelError: They are not three numbers.
        """
        text = self.text(tag, "0 0 0")
        where, slug = f"{self.subject}, {tag}", f"{self._slug}.{tag}"
        x, y, z = read_numbers(text, counts=(3,), where=where, slug=slug)
        return (x, y, z)

    def length(self, tag: str, default: float) -> float:
        """Read a length [m], > 0.

        Raises:
            ModelError: It is not.
        """
        return (self.positive_numbers(tag) or [default])[0]

    def positive_numbers(self, tag: str) -> list[float]:
        """Read the numbers of a repeatable tag, > 0.

        Raises:
            ModelError: One is not.
        """
        numbers = [self._parse_number(tag, text) for text in self.texts(tag)]
        for number in numbers:
            if number <= 0.0:
                raise self._make_error(tag, f"{number:g} is not positive; write a length in metres")
        return numbers

    def flag(self, tag: str, *, default: bool) -> bool:
        """Read true, false, 1 or 0."""
        text = self.text(tag, "")
        flag = parse_flag(text)
        if text and flag is None:
            self.report.suspicious(self.label(tag), f"{text[:40]!r} is neither true nor false")
        return default if flag is None else flag

    def ros(self) -> RosBlock:
        """Read the <ros> block."""
        if self._ros is None:
            return RosBlock()
        return read_ros_block(self._ros, subject=self.subject, report=self.report)

    def report_unread(self, unused: Mapping[str, str]) -> None:
        """Report all that was not read; `unused` has the reasons for known tags."""
        unread = [tag for tag in self._texts if tag not in self._read]
        for tag in (*unread, *self._list_unread_bare(unread)):
            path, separator, attribute = tag.rpartition("@")
            if tag in unused:
                self.report.ignored(self.label(tag), unused[tag])
            elif separator:
                owner = self.label(path) if path else self.subject
                self.report.unread_attribute(owner, attribute, ())
            else:
                self.report.unread_tag(self.subject, tag, sorted(self._read))

    def _list_unread_bare(self, unread: Iterable[str]) -> Iterator[str]:
        """List what nothing read and what is in no tag that is reported."""
        reported = set(unread)
        for tag in self._bare:
            parts = _PATH_ENDS.split(tag)
            parts[0] = self._aliases.get(parts[0], parts[0])
            above = {"/".join(parts[:count]) for count in range(1, len(parts))}
            if tag not in self._read and reported.isdisjoint(above):
                yield tag

    def _parse_number(self, tag: str, text: str) -> float:
        return read_number(text, where=f"{self.subject}, {tag}", slug=self._make_slug(tag))

    def _make_slug(self, tag: str) -> str:
        return f"{self._slug}.{tag.rpartition('/')[2]}"

    def _make_error(self, tag: str, fault: str) -> ModelError:
        return ModelError(f"{self.subject}, {tag}: {fault}", slug=self._make_slug(tag))
