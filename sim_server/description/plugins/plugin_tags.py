"""Tags of one plug-in, older spellings included, and its <ros> block."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import RosBlock
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.names import InvalidName, check_namespace
from zensim.sim_server.description.strict_parsing import read_number, read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from lxml.etree import _Element as Element

    from zensim.proto.messages.model_messages import Vec3
    from zensim.sim_server.description.report import ParseReport

UNUSED_ROS_TAGS = {
    "argument": "there is no ROS node to pass it to",
    "parameter": "there is no ROS node to pass it to",
    "qos": "quality of service is the network's own",
}
ROS_TAGS = ("namespace", "remapping", *UNUSED_ROS_TAGS)


def read_ros_block(ros: Element, *, subject: str, report: ParseReport) -> RosBlock:
    """Read a <ros> block; what cannot be used is noted and left out."""
    namespaces: list[str] = []
    remappings: list[str] = []
    for child in ros:
        text = (child.text or "").strip()
        if child.tag == "namespace":
            namespaces.append(text)
        elif child.tag == "remapping":
            remappings += _read_remapping(text, subject=subject, report=report)
        elif child.tag in UNUSED_ROS_TAGS:
            report.ignored(f"{subject}: <{child.tag}>", UNUSED_ROS_TAGS[child.tag])
        else:
            report.unread_tag(f"{subject}: <ros>", child.tag, ROS_TAGS)
    namespace = _read_namespace(namespaces, subject=subject, report=report)
    return RosBlock(namespace=namespace, remappings=tuple(remappings))


def _read_remapping(text: str, *, subject: str, report: ParseReport) -> list[str]:
    """Take a rule if it leads to a name that ROS has."""
    old, separator, new = (part.strip() for part in text.partition(":="))
    if not (old and separator and new):
        report.suspicious(f"{subject}: <remapping>", f"{text[:80]!r} is not 'from:=to'")
        return []
    try:
        # Relative names are within some namespace.
        check_namespace(new if new.startswith("/") else f"robot/{new}")
    except InvalidName:
        report.suspicious(
            f"{subject}: <remapping>",
            f"{new[:80]!r} is no topic of ROS; use names joined by '/', as 'team/odom'; not used",
        )
        return []
    return [text]


def _read_namespace(written: list[str], *, subject: str, report: ParseReport) -> str:
    if len(written) > 1:
        report.suspicious(
            f"{subject}: <namespace>", f"given {len(written)} times; the first counts"
        )
    text = written[0].strip("/") if written else ""
    if not text:
        return ""
    try:
        return check_namespace(text)
    except InvalidName as error:
        report.suspicious(f"{subject}: <namespace>", f"{error}; not used")
        return ""


FLAG_TEXTS = {"true": True, "1": True, "false": False, "0": False}


class PluginTags:
    """Tags by name; each reading method marks its tag as read.

    Args:
        plugin: The element.
        slug: First half of the slugs raised, such as `drive`.
        aliases: Older spellings, and the tag that each stands for.
        report: Where oddities go.
    """

    def __init__(
        self, plugin: Element, *, slug: str, aliases: Mapping[str, str], report: ParseReport
    ) -> None:
        self.subject = f"plugin {(plugin.get('name') or '')[:80]!r}"
        self.filename = plugin.get("filename") or ""
        self.report = report
        self._slug = slug
        self._ros = plugin.find("ros")
        self._texts: dict[str, list[str]] = {}
        self._renamed: set[str] = set()
        self._read = {"ros"}
        for child in plugin:
            tag = aliases.get(child.tag, child.tag)
            if tag != child.tag:
                self._renamed.add(tag)
                report.suspicious(
                    f"{self.subject}: <{child.tag}>", f"spelling of ROS 1; read as <{tag}>"
                )
            self._texts.setdefault(tag, []).append((child.text or "").strip())

    def is_renamed(self, tag: str) -> bool:
        """Whether the tag is there under an older spelling."""
        return tag in self._renamed

    def texts(self, tag: str) -> list[str]:
        """Read a tag that may be repeated."""
        self._read.add(tag)
        return self._texts.get(tag, [])

    def text(self, tag: str, default: str) -> str:
        """Read a tag; the first counts, an empty one is as none."""
        written = self.texts(tag)
        if len(written) > 1:
            self.report.suspicious(
                f"{self.subject}: <{tag}>", f"given {len(written)} times; the first counts"
            )
        return (written[0] if written else "") or default

    def number(self, tag: str, default: float) -> float:
        """Read a number.

        Raises:
            ModelError: It is none, or negative.
        """
        number = self._parse_number(tag, self.text(tag, repr(default)))
        if number < 0.0:
            raise self._make_error(tag, f"{number:g} is negative; write a number >= 0")
        return number

    def signed(self, tag: str) -> float | None:
        """Read a number of either sign; None when it is not there.

        Raises:
            ModelError: It is none.
        """
        text = self.text(tag, "")
        return self._parse_number(tag, text) if text else None

    def vector(self, tag: str) -> Vec3:
        """Read three numbers; 0 0 0 when they are not there.

        Raises:
            ModelError: They are not three numbers.
        """
        text = self.text(tag, "0 0 0")
        where, slug = f"{self.subject}, {tag}", f"{self._slug}.{tag}"
        x, y, z = read_numbers(text, counts=(3,), where=where, slug=slug)
        return (x, y, z)

    def length(self, tag: str, default: float) -> float:
        """Read a length [m].

        Raises:
            ModelError: It is no number, or not positive.
        """
        return (self.positive_numbers(tag) or [default])[0]

    def positive_numbers(self, tag: str) -> list[float]:
        """Read a repeated number.

        Raises:
            ModelError: One is not positive.
        """
        numbers = [self._parse_number(tag, text) for text in self.texts(tag)]
        for number in numbers:
            if number <= 0.0:
                raise self._make_error(tag, f"{number:g} is not positive; write a length in metres")
        return numbers

    def flag(self, tag: str, *, default: bool) -> bool:
        """Read true, false, 1 or 0."""
        text = self.text(tag, "")
        if text and text.lower() not in FLAG_TEXTS:
            self.report.suspicious(
                f"{self.subject}: <{tag}>", f"{text[:40]!r} is neither true nor false"
            )
        return FLAG_TEXTS.get(text.lower(), default)

    def ros(self) -> RosBlock:
        """Read the <ros> block."""
        if self._ros is None:
            return RosBlock()
        return read_ros_block(self._ros, subject=self.subject, report=self.report)

    def report_unread(self, unused: Mapping[str, str]) -> None:
        """Note every tag that was not read; `unused` gives the reason for those that are known."""
        for tag in self._texts:
            if tag in unused:
                self.report.ignored(f"{self.subject}: <{tag}>", unused[tag])
            elif tag not in self._read:
                self.report.unread_tag(self.subject, tag, sorted(self._read))

    def _parse_number(self, tag: str, text: str) -> float:
        if text.startswith(("${", "$(")):
            raise ModelError(
                f"{self.subject}, {tag}: {text[:80]!r} is xacro's; run xacro on it first",
                code=SpawnCode.UNSUPPORTED_FORMAT,
                slug="urdf.xacro",
            )
        return read_number(text, where=f"{self.subject}, {tag}", slug=f"{self._slug}.{tag}")

    def _make_error(self, tag: str, fault: str) -> ModelError:
        return ModelError(f"{self.subject}, {tag}: {fault}", slug=f"{self._slug}.{tag}")
