"""Which elements and attributes of URDF and SDF are read, and a pass that reports all others.

A table of rules says of each element what the readers use; `check_element` compares a document with
it. Nothing outside the table is without a word, and what is known to have no effect says why. Open
vocabularies, those of plug-ins and sensors, are lists of tags that readers mark; see `PluginTags`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec

from zensim.sim_server.description.strict_parsing import read_numbers
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import ParseReport

NumberCounts = tuple[int, ...]
TEXT: NumberCounts = ()
"""Printable text that is not long."""
ANY_TEXT: NumberCounts = (0,)
"""Text that its reader checks."""
ONE: NumberCounts = (1,)
MAX_TEXT_LENGTH = 256
ZENSIM_PREFIX = "zensim:"
OLD_GAZEBO_PREFIXES = ("controller:", "interface:", "sensor:", "geom:", "body:", "rendering:")
OLD_GAZEBO_NAMESPACE = "playerstage.sourceforge.net"


class ElementRule(msgspec.Struct, frozen=True):
    """Attributes and children of one element."""

    attributes: dict[str, NumberCounts] = {}
    """Allowed counts of numbers by name; `TEXT` or `ANY_TEXT` for text. Also those that mean
    nothing to anybody, such as names."""
    required: tuple[str, ...] = ()
    """Attributes that must not be missing or empty."""
    children: dict[str, ElementRule] = {}
    needed: tuple[str, ...] = ()
    """Children that must not be missing."""
    many: tuple[str, ...] = ()
    """Children that may be repeated."""
    unread: str = ""
    """Reason why the element has no effect; empty when it has one."""
    idle: tuple[str, ...] = ()
    """Texts with which an unread element has no effect anywhere; they need no word."""
    unused: dict[str, str] = {}
    """Attributes that others write, and why they have no effect."""
    others: str = ""
    """Reason why all other children have no effect; empty: they are unknown."""
    is_opaque: bool = False
    """Whether its reader, not the rule, checks or reports its contents."""
    is_choice: bool = False
    """Whether it has one of its children."""
    is_top: bool = False
    """The report names its children without it."""
    can_be_left_out: bool = False
    """The robot moves the same without it: a fault leaves it out."""


LEAF = ElementRule()
OPAQUE = ElementRule(is_opaque=True)
NAMED: dict[str, NumberCounts] = {"name": ANY_TEXT}
POSE = ElementRule(
    attributes=dict.fromkeys(("relative_to", "frame", "degrees", "rotation_format"), ANY_TEXT)
)


def make_leaves(*tags: str) -> dict[str, ElementRule]:
    """Make rules of elements that have only a text."""
    return dict.fromkeys(tags, LEAF)


def make_unread(reason: str, *tags: str, idle: tuple[str, ...] = ()) -> dict[str, ElementRule]:
    """Make rules of elements without effect."""
    return dict.fromkeys(tags, ElementRule(unread=reason, idle=idle))


def make_tree(paths: Iterable[str], known: dict[str, ElementRule]) -> dict[str, ElementRule]:
    """Make rules of the leaves at these paths, beside known rules by path."""
    nested: dict[str, dict[str, ElementRule]] = {}
    for path, rule in (dict.fromkeys(paths, LEAF) | known).items():
        first, _, rest = path.partition("/")
        nested.setdefault(first, {})[rest] = rule
    return {
        first: below[""] if "" in below else ElementRule(children=make_tree((), below))
        for first, below in nested.items()
    }


def zensim_tag(child: Element) -> str:
    """Get the tag, without prefix, of an element of the zensim namespace; empty for others."""
    tag = str(child.tag)
    if tag.startswith(ZENSIM_PREFIX):
        return tag.removeprefix(ZENSIM_PREFIX)
    space, separator, name = tag.rpartition("}")
    return name if separator and "zensim" in space else ""


def find_name(child: Element) -> str:
    """Get the tag of an element, with `zensim:` for every way to write that namespace."""
    own = zensim_tag(child)
    return f"{ZENSIM_PREFIX}{own}" if own else str(child.tag)


def check_element(element: Element, rule: ElementRule, where: str, report: ParseReport) -> None:
    """Compare an element with its rule, and all below it; what has no effect is reported.

    Args:
        element: Empty attributes of numbers, and faulty parts that can be left out, are removed.
        rule: Of the element.
        where: Place for the report.
        report: Gets what is not used.

    Raises:
        ModelError: A required tag or attribute of URDF is missing, or a value is not a number.
    """
    _Comparison(report).compare(element, rule, where)


@dataclass(frozen=True)
class _Comparison:
    """Compares elements with their rules."""

    report: ParseReport

    def compare(self, element: Element, rule: ElementRule, where: str) -> None:
        if rule.is_opaque:
            return
        self._check_attributes(element, rule, where)
        if rule.is_choice:
            self._check_choice(element, rule, where)
        seen = self._compare_children(element, rule, where)
        for needed in rule.needed:
            if needed not in seen:
                raise ModelError(f"{where} has no <{needed}>; add one", slug=f"urdf.{needed}")

    def _compare_children(self, element: Element, rule: ElementRule, where: str) -> set[str]:
        seen: set[str] = set()
        for child in list(element):
            name = child.tag
            if (below := rule.children.get(name)) is None:
                name = find_name(child)
                below = rule.children.get(name)
            if below is None:
                self._report_unlisted(child, rule, where)
            elif below.unread:
                self._report_unread(child, below, f"{where}: <{name}>")
            else:
                if name in seen and name not in rule.many:
                    place = _describe_place(where, child, rule)
                    self.report.suspicious(place, "given more than once; the first is used")
                if not _is_plain(child, below):
                    self._compare_child(child, below, _describe_place(where, child, rule))
            seen.add(name)
        return seen

    def _compare_child(self, child: Element, rule: ElementRule, place: str) -> None:
        try:
            self.compare(child, rule, place)
        except ModelError as error:
            parent = child.getparent()
            if not rule.can_be_left_out or parent is None:
                raise
            self.report.suspicious(place, f"{error.fault}; left out")
            parent.remove(child)

    def _report_unread(self, child: Element, rule: ElementRule, subject: str) -> None:
        text = (child.text or "").strip().lower()
        if len(child) or child.keys() or text not in rule.idle:
            self.report.ignored(subject, rule.unread)

    def _report_unlisted(self, child: Element, rule: ElementRule, where: str) -> None:
        tag = str(child.tag)
        if tag.startswith(OLD_GAZEBO_PREFIXES) or OLD_GAZEBO_NAMESPACE in tag:
            kind = tag.partition(":")[0] if "}" not in tag else "tags"
            self.report.ignored(f"{where}: <{kind}:...>", "of Gazebo 0.x, which ended in 2012")
        elif rule.others:
            self.report.ignored(f"{where}: <{tag[:80]}>", rule.others)
        else:
            self.report.unread_tag(where, tag, rule.children)

    def _check_attributes(self, element: Element, rule: ElementRule, where: str) -> None:
        for name, value in element.items():
            counts = rule.attributes.get(name)
            if name in rule.unused:
                self.report.ignored(f"{where}: attribute {name}", rule.unused[name])
            elif counts is None:
                self.report.unread_attribute(where, name, rule.attributes)
            elif counts not in (TEXT, ANY_TEXT) and not value.strip() and name not in rule.required:
                self.report.suspicious(f"{where}, {name}", "empty; the default is used")
                element.attrib.pop(name)
            else:
                self._check_value(value, counts, f"{where}, {name}")
        for name in rule.required:
            if not (element.get(name) or "").strip():
                fault = f'{where} has no {name}; write {name}="..."'
                raise ModelError(fault, slug=f"urdf.{name}")

    def _check_value(self, value: str, counts: NumberCounts, where: str) -> None:
        if counts == ANY_TEXT:
            return
        if counts:
            read_numbers(value, counts=counts, where=where, slug="urdf.number")
        elif len(value) > MAX_TEXT_LENGTH or not value.isprintable():
            raise ModelError(
                f"{where}: {value[:40]!r}... cannot be used; "
                f"write at most {MAX_TEXT_LENGTH} printable characters",
                slug="urdf.text",
            )

    def _check_choice(self, element: Element, rule: ElementRule, where: str) -> None:
        choices = [str(child.tag) for child in element]
        if not choices or choices[0] not in rule.children:
            content = f"<{choices[0][:80]}>" if choices else "nothing"
            raise ModelError(
                f"{where} contains {content}; write one of {', '.join(rule.children)}",
                slug="urdf.geometry",
            )
        if len(choices) > 1:
            self.report.suspicious(where, f"{len(choices)} shapes; the first is used")


def _is_plain(child: Element, rule: ElementRule) -> bool:
    """Whether an element has nothing to compare, as most have: their places are not written."""
    return (
        not len(child) and not child.keys() and not (rule.required or rule.needed or rule.is_choice)
    )


def _describe_place(where: str, child: Element, rule: ElementRule) -> str:
    if not rule.is_top:
        return f"{where}, {child.tag}"
    if child.tag not in rule.many:
        return str(child.tag)
    name = child.get("name")
    return f"{child.tag} {name[:80]!r}" if name else f"{child.tag} at line {child.sourceline}"
