"""A description as the operator's side reads it: no DOCTYPE, bounded depth; how it refuses one."""

import re
import xml.etree.ElementTree as ET

from proto.result import ServiceError, SpawnCode

MAX_DEPTH = 64
MAX_TEXT_BYTES = 8 << 20
ROOTS = ("robot", "sdf")
BLANKS = "\ufeff \t\r\n"
_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)


class DescriptionError(ValueError):
    """A text that is no robot description."""


class _NoDoctype(ET.TreeBuilder):
    def doctype(self, name: str, *_: str | None) -> None:
        """Refuse a DOCTYPE before its entities are read."""
        raise DescriptionError(f"the description has a DOCTYPE {name[:80]!r}; remove it")


def refused(code: SpawnCode, slug: str, fault: str) -> ServiceError:
    """Make the refusal that the server would give, before anything is sent."""
    return ServiceError("spawn_entity", code, code.name, f"{slug}: {fault}")


def without_comments(text: str) -> str:
    """Blank comments out, all but their line ends, so that lines keep their numbers.

    Gazebo takes comments with two hyphens inside, which XML parsers refuse.
    """
    return _COMMENT.sub(lambda comment: "\n" * comment[0].count("\n"), text)


def parsed(text: str) -> ET.Element:
    """Read a URDF or an SDF into elements.

    Raises:
        DescriptionError: It is no XML, has a DOCTYPE, is too deep, or begins otherwise.
    """
    try:
        root = _elements(text)
    except (ET.ParseError, UnicodeEncodeError) as error:
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
        bare = without_comments(text).lstrip(BLANKS)
        return ET.fromstring(bare, parser=ET.XMLParser(target=_NoDoctype()))


def _check_depth(root: ET.Element) -> None:
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise DescriptionError(f"the description nests tags more than {MAX_DEPTH} deep")
