"""Strict parsing of untrusted XML: no DTD, limits on size, depth and attributes."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from lxml import etree

from zensim.proto.messages.result_messages import SpawnCode
from zensim.sim_server.description.strict_parsing import to_single_line
from zensim.sim_server.errors import ModelError

if TYPE_CHECKING:
    from lxml.etree import _Element as Element


HEAD_BYTES = 65536
"""Bytes of a file in which its format is searched."""
OTHER_FORMATS = (
    (
        re.compile(r"^levels\s*:", re.MULTILINE),
        "this is a building map of Open-RMF, no world; make a world of it with 'ros2 run "
        "rmf_building_map_tools building_map_generator gazebo MAP WORLD MODELS'",
    ),
    (re.compile(r"\A#VRML"), "this is a file of Webots; export the robot as URDF, a world as SDF"),
    (re.compile(r"\A(?:#usda|PXR-USDC)"), "this is USD; convert it to URDF or SDF"),
    (
        re.compile(r"\A[\w./-]+:(?:\s|$)"),
        "this is YAML, no URDF or SDF; a scenario is started with 'zensim up FILE'",
    ),
)
"""Formats that users have and that are not read, by their beginning, and what to do."""
MAX_BYTES = 8 * 1024 * 1024
MAX_TAGS = 40_000
"""Number of `<` in the text: limits memory and parse time. A robot of 500 links has fewer."""
MAX_DEPTH = 64
MAX_ATTRIBUTES = 64
"""Attributes of one element: lxml needs n * n steps to list n attributes."""
_NAMESPACE_FAULTS = {201, 202}
"""XML_NS_ERR_UNDEFINED_NAMESPACE and XML_NS_ERR_QNAME of libxml2 (`<gz::tag>`); URDF parsers
ignore namespaces."""
_SPACES = re.compile(rb"[ \t\r\n]+")
_HYPHENS_IN_COMMENT = 80
"""XML_ERR_HYPHEN_IN_COMMENT of libxml2; Gazebo accepts these comments."""
_DECLARATION = re.compile(rb"<\?xml[ \t\r\n][^<>]{0,400}?\?>")
_BEFORE_ROOT = re.compile(r"(?:[\ufeff\s]+|<!--.*?-->|<\?.*?\?>)*", re.DOTALL)
_ROOT_NAME = re.compile(r"<([^\s/<>]{1,80})[\s/>]")


def find_root_tag(text: str) -> str:
    """Find the name of a document's root tag without parsing it; empty if there is none."""
    before = _BEFORE_ROOT.match(text)
    found = _ROOT_NAME.match(text, before.end() if before else 0)
    return found[1] if found else ""


def parse_xml(text: str, *, root_tag: str, slug: str, max_tags: int = MAX_TAGS) -> Element:
    """Parse a document; comments and processing instructions are left out.

    Args:
        text: The document; the encoding in its XML declaration is ignored.
        root_tag: Expected tag of the root; its default namespace is removed from all tags.
        slug: Expected format, such as `urdf`.
        max_tags: Most tags, opening and closing.

    Raises:
        ModelError: Not well-formed, another root, too large, too deep, or a DOCTYPE.
    """
    data = _encode_bounded(text, slug, max_tags)
    if _has_doctype(data):
        raise ModelError(
            "the description has a DOCTYPE; remove it, since entities are not expanded",
            slug="xml.doctype",
        )
    root = _parse_bytes(data)
    _drop_default_namespace(root, root_tag)
    if root.tag != root_tag:
        raise ModelError(
            f"the root of the description is <{root.tag[:80]}>; use <{root_tag}>",
            code=SpawnCode.UNSUPPORTED_FORMAT,
            slug=f"{slug}.root",
        )
    _check_depth(root)
    return root


def _encode_bounded(text: str, slug: str, max_tags: int) -> bytes:
    try:
        data = text.lstrip("\ufeff \t\r\n").encode()
    except UnicodeEncodeError as error:
        raise ModelError(
            f"the description is not text: lone surrogate at character {error.start}",
            slug="xml.encoding",
        ) from error
    if not data:
        raise ModelError(
            f"the description is empty; send the text of a {slug.upper()} file",
            code=SpawnCode.NO_RESOURCE,
            slug="xml.empty",
        )
    if len(data) > MAX_BYTES or data.count(b"<") > max_tags:
        raise ModelError(
            f"the description has {len(data)} bytes and {data.count(b'<')} tags; "
            f"at most {MAX_BYTES} bytes and {max_tags} tags are read",
            slug="xml.size",
        )
    return data


def _without_comments(data: bytes) -> bytes:
    # Line ends stay, so that line numbers in errors are right.
    pieces, at = [], 0
    while (start := data.find(b"<!--", at)) >= 0 and (end := data.find(b"-->", start + 4)) >= 0:
        pieces += [data[at:start], b"\n" * data.count(b"\n", start, end)]
        at = end + len(b"-->")
    return b"".join([*pieces, data[at:]])


def _without_declaration(data: bytes) -> bytes:
    # URDF parsers accept a declaration after comments or with version 0.0.
    at = 0
    while closing := _closing_marker(data, at):
        if found := _DECLARATION.match(data, at):
            return data[:at] + data[found.end() :]
        end = data.find(closing, at)
        if end < 0:
            break
        at = _skip_spaces(data, end + len(closing))
    return data


def _has_doctype(data: bytes) -> bool:
    # XML allows a DOCTYPE only before the root, after comments and instructions.
    at = 0
    while not data.startswith(b"<!DOCTYPE", at):
        closing = _closing_marker(data, at)
        end = data.find(closing, at) if closing else -1
        if end < 0:
            return False
        at = _skip_spaces(data, end + len(closing))
    return True


def _closing_marker(data: bytes, at: int) -> bytes:
    if data.startswith(b"<!--", at):
        return b"-->"
    return b"?>" if data.startswith(b"<?", at) else b""


def _skip_spaces(data: bytes, at: int) -> int:
    found = _SPACES.match(data, at)
    return found.end() if found else at


def _parse_bytes(data: bytes) -> Element:
    text = _without_declaration(data)
    parser = _make_parser(recover=False)
    try:
        return etree.fromstring(text, parser)
    except etree.XMLSyntaxError as error:
        faults = {entry.type for entry in parser.error_log}
        if faults and faults <= _NAMESPACE_FAULTS:
            return etree.fromstring(text, _make_parser(recover=True))
        bare = _without_comments(text)
        if faults - _NAMESPACE_FAULTS == {_HYPHENS_IN_COMMENT} and bare != text:
            return _parse_bytes(bare)
        raise ModelError(
            _name_format(text)
            or f"the description is not well-formed XML: {to_single_line(error.msg or '')}",
            slug="xml.syntax",
        ) from error


def _name_format(data: bytes) -> str:
    """Name a format that is not read, and what makes a readable file of it; empty if unknown."""
    head = data[:HEAD_BYTES].decode("utf-8", "replace")
    return next((advice for format_, advice in OTHER_FORMATS if format_.search(head)), "")


def _make_parser(*, recover: bool) -> etree.XMLParser:
    return etree.XMLParser(
        encoding="utf-8",
        huge_tree=False,
        load_dtd=False,
        no_network=True,
        recover=recover,
        remove_comments=True,
        remove_pis=True,
        resolve_entities=False,
    )


def _drop_default_namespace(root: Element, root_tag: str) -> None:
    namespace, _, name = root.tag.rpartition("}")
    if not namespace or name != root_tag:
        return
    prefix = namespace + "}"
    for element in root.iter():
        element.tag = element.tag.removeprefix(prefix)


def _check_depth(root: Element) -> None:
    level = [root]
    for _ in range(MAX_DEPTH):
        _check_attributes(level)
        level = [child for element in level for child in element]
        if not level:
            return
    raise ModelError(
        f"tags are nested more than {MAX_DEPTH} deep, at line {level[0].sourceline}",
        slug="xml.depth",
    )


def _check_attributes(elements: list[Element]) -> None:
    for element in elements:
        if len(element.attrib) > MAX_ATTRIBUTES:
            raise ModelError(
                f"<{element.tag[:80]}> at line {element.sourceline} has {len(element.attrib)} "
                f"attributes; at most {MAX_ATTRIBUTES} are read",
                slug="xml.size",
            )
