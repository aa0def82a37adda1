"""A description as the operator's side reads it: no DOCTYPE, bounded depth; how it refuses one."""

import xml.etree.ElementTree as ET
from typing import NamedTuple
from xml.parsers import expat

from zensim.proto.messages.result_messages import ServiceError, SpawnCode

MAX_DEPTH = 64
MAX_TEXT_BYTES = 2 << 20
"""A request has `MAX_REQUEST_BYTES`, in JSON with escapes."""
ROOTS = ("robot", "sdf")
BLANKS = "\ufeff \t\r\n"


class DescriptionError(ValueError):
    """A text that is no robot description."""


class Written(NamedTuple):
    """How many links and joints a description has, before any are merged."""

    links: int
    joints: int


class _NoDoctype(ET.TreeBuilder):
    def doctype(self, name: str, *_: object) -> None:
        """Refuse a DOCTYPE before its entities are read."""
        raise DescriptionError(f"the description has a DOCTYPE {name[:80]!r}; remove it")


def refused(code: SpawnCode, slug: str, fault: str) -> ServiceError:
    """Make the refusal that the server would give, before anything is sent."""
    return ServiceError("spawn_entity", code, code.name, f"{slug}: {fault}")


def without_comments(text: str) -> str:
    """Blank comments out, all but their line ends, so that lines keep their numbers.

    Gazebo takes comments with two hyphens inside, which XML parsers refuse.
    """
    pieces, at = [], 0
    while (start := text.find("<!--", at)) >= 0 and (end := text.find("-->", start + 4)) >= 0:
        pieces += [text[at:start], "\n" * text.count("\n", start, end)]
        at = end + len("-->")
    return "".join([*pieces, text[at:]])


def parsed(text: str) -> ET.Element:
    """Read a URDF or an SDF into elements.

    Raises:
        DescriptionError: It is no XML, has a DOCTYPE, is too deep, or begins otherwise.
    """
    try:
        root = _elements(text)
    except (expat.ExpatError, UnicodeEncodeError) as error:
        raise DescriptionError(f"the description is not well-formed XML: {error}") from error
    if root.tag not in ROOTS:
        raise DescriptionError(
            f"the description begins with <{root.tag[:80]}>; a URDF begins with <robot>, "
            "an SDF with <sdf>"
        )
    _check_depth(root)
    return root


def _elements(text: str) -> ET.Element:
    try:
        return ET.fromstring(text.lstrip(BLANKS), parser=ET.XMLParser(target=_NoDoctype()))
    except ET.ParseError:
        return _as_gazebo_does(without_comments(text).lstrip(BLANKS))


def _as_gazebo_does(text: str) -> ET.Element:
    # Prefixes need not be declared: they are part of the name.
    parser, tree = expat.ParserCreate(), _NoDoctype()
    parser.StartDoctypeDeclHandler = tree.doctype
    parser.StartElementHandler = tree.start
    parser.EndElementHandler = tree.end
    parser.CharacterDataHandler = tree.data
    parser.Parse(text, True)  # noqa: FBT003 - expat knows it by place only
    return tree.close()


def _check_depth(root: ET.Element) -> None:
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise DescriptionError(f"the description nests tags more than {MAX_DEPTH} deep")


def counted(root: ET.Element) -> Written:
    """Count the links and joints of a URDF or SDF; what it includes is left out."""
    owners = [root] if root.tag == "robot" else list(root.iter("model"))
    return Written(*(sum(len(owner.findall(tag)) for owner in owners) for tag in ("link", "joint")))
