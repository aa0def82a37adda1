"""XML of descriptions: parsing without DOCTYPE and with limited depth; namespaces of drives."""

import xml.etree.ElementTree as ET
from collections.abc import Callable
from typing import NamedTuple
from xml.parsers import expat

from zensim.proto.messages.result_messages import ServiceError, SpawnCode
from zensim.proto.names import check_namespace

MAX_DEPTH = 64
MAX_TEXT_BYTES = 2 << 20
"""Limit below `MAX_REQUEST_BYTES`, as JSON adds escapes."""
ROOT_TAGS = ("robot", "sdf")
BLANKS = "\ufeff \t\r\n"


class DescriptionError(ValueError):
    """A text is not a robot description."""


class ElementCounts(NamedTuple):
    """Numbers of links and joints of a description, before fixed joints are merged."""

    links: int
    joints: int


class _NoDoctypeBuilder(ET.TreeBuilder):
    def doctype(self, name: str, *_: object) -> None:
        """Refuse a DOCTYPE before its entities are parsed."""
        raise DescriptionError(f"the description has a DOCTYPE {name[:80]!r}; remove it")


def make_refusal(code: SpawnCode, slug: str, fault: str) -> ServiceError:
    """Make the error that the server would return."""
    return ServiceError("spawn_entity", code, code.name, f"{slug}: {fault}")


def blank_comments(text: str) -> str:
    """Remove comments, but keep their line breaks, so that line numbers stay valid.

    Gazebo accepts comments that contain two hyphens, which XML parsers refuse.
    """
    pieces, at = [], 0
    while (start := text.find("<!--", at)) >= 0 and (end := text.find("-->", start + 4)) >= 0:
        pieces += [text[at:start], "\n" * text.count("\n", start, end)]
        at = end + len("-->")
    return "".join([*pieces, text[at:]])


def parse_description(text: str) -> ET.Element:
    """Parse a URDF or an SDF.

    Raises:
        DescriptionError: The text is not XML, has a DOCTYPE, is nested too deep, or is neither.
    """
    try:
        root = _parse_elements(text)
    except (expat.ExpatError, UnicodeEncodeError) as error:
        raise DescriptionError(f"the description is not well-formed XML: {error}") from error
    _strip_default_namespace(root)
    if root.tag not in ROOT_TAGS:
        raise DescriptionError(
            f"the root element is <{root.tag[:80]}>; use <robot> for URDF or <sdf> for SDF"
        )
    _check_depth(root)
    return root


def _strip_default_namespace(root: ET.Element) -> None:
    """Remove the default namespace of the root from all tags, as readers of URDF do."""
    if not root.tag.startswith("{"):
        return
    prefix = root.tag[: root.tag.index("}") + 1]
    for element in root.iter():
        element.tag = element.tag.removeprefix(prefix)


def _parse_elements(text: str) -> ET.Element:
    try:
        return ET.fromstring(text.lstrip(BLANKS), parser=ET.XMLParser(target=_NoDoctypeBuilder()))
    except ET.ParseError:
        return _parse_as_gazebo(blank_comments(text).lstrip(BLANKS))


def _parse_as_gazebo(text: str) -> ET.Element:
    # Unlike ElementTree, this accepts undeclared namespace prefixes.
    parser, tree = expat.ParserCreate(), _NoDoctypeBuilder()
    parser.StartDoctypeDeclHandler = tree.doctype
    parser.StartElementHandler = tree.start
    parser.EndElementHandler = tree.end
    parser.CharacterDataHandler = tree.data
    parser.Parse(text, True)  # noqa: FBT003 - positional-only in expat
    return tree.close()


def _check_depth(root: ET.Element) -> None:
    level = [root]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise DescriptionError(f"the description nests tags more than {MAX_DEPTH} deep")


def count_elements(root: ET.Element) -> ElementCounts:
    """Count the links and joints of a URDF or SDF, without included models."""
    owners = [root] if root.tag == "robot" else list(root.iter("model"))
    return ElementCounts(
        *(sum(len(owner.findall(tag)) for owner in owners) for tag in ("link", "joint"))
    )


DRIVE_FILES = ("gazebo_ros_diff_drive", "gazebo_ros_skid_steer_drive")
DRIVE_NAME = "differential_drive_controller"


def add_namespace(urdf_text: str, namespace: str) -> str:
    """Set the namespace of every differential drive, and remap its /tf into the namespace.

    A drive is a plug-in with a file name of `DRIVE_FILES` or the name `DRIVE_NAME`. A present
    namespace and remapping of /tf are replaced. Without a drive the text is returned unchanged.

    Args:
        urdf_text: Description with expanded xacro.
        namespace: With or without a leading slash.

    Raises:
        DescriptionError: See `parse_description`.
        InvalidName: The namespace is not valid.
    """
    bare = check_namespace(namespace)
    return _change_drives(urdf_text, lambda drive: _set_namespace(drive, f"/{bare}"))


def remove_namespace(urdf_text: str) -> str:
    """Remove namespace and remapping of /tf from every drive.

    The result is valid for all robots of a fleet; each gets its namespace from its spawn order.

    Raises:
        DescriptionError: See `parse_description`.
    """
    return _change_drives(urdf_text, _clear_namespace)


def _change_drives(urdf_text: str, change: Callable[[ET.Element], None]) -> str:
    robot = parse_description(urdf_text)
    drives = [plugin for plugin in robot.iter("plugin") if _is_drive(plugin)]
    for drive in drives:
        change(drive)
    return ET.tostring(robot, encoding="unicode") if drives else urdf_text


def _is_drive(plugin: ET.Element) -> bool:
    filename = plugin.get("filename", "")
    return DRIVE_NAME in plugin.attrib.values() or any(file in filename for file in DRIVE_FILES)


def _set_namespace(drive: ET.Element, namespace: str) -> None:
    _clear_namespace(drive)
    ros = drive.find("ros")
    if ros is None:
        ros = ET.SubElement(drive, "ros")
    ET.SubElement(ros, "namespace").text = namespace
    ET.SubElement(ros, "remapping").text = f"/tf:={namespace}/tf"


def _clear_namespace(drive: ET.Element) -> None:
    if (ros := drive.find("ros")) is None:
        return
    for child in list(ros):
        if child.tag == "namespace" or _remaps_tf(child):
            ros.remove(child)


def _remaps_tf(child: ET.Element) -> bool:
    old, separator, _ = (child.text or "").partition(":=")
    return child.tag == "remapping" and bool(separator) and old.strip() in ("/tf", "tf")
