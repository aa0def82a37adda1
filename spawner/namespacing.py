"""A robot's own namespace, written into the drive of its URDF."""

import xml.etree.ElementTree as ET

from proto.names import check_namespace

DRIVE_FILES = ("gazebo_ros_diff_drive", "gazebo_ros_skid_steer_drive")
DRIVE_NAME = "differential_drive_controller"
MAX_DEPTH = 64


class DescriptionError(ValueError):
    """A text that is no robot description."""


class _NoDoctype(ET.TreeBuilder):
    def doctype(self, name: str, *_: str | None) -> None:
        """Refuse a DOCTYPE before its entities are read."""
        raise DescriptionError(f"the description has a DOCTYPE {name[:80]!r}; remove it")


def namespaced(urdf_text: str, namespace: str) -> str:
    """Give every differential drive this namespace, and a tf topic inside it.

    A drive is found by its plug-in's file or by the name `differential_drive_controller`. Its
    <ros> block is made when missing; a namespace and a remapping of /tf that it has are replaced,
    so that doing this twice is as doing it once. Without a drive the text is returned as it is.

    Args:
        urdf_text: The description, any xacro expanded.
        namespace: With or without a leading slash.

    Raises:
        DescriptionError: The text is no XML, has a DOCTYPE, or its root is not <robot>.
        InvalidName: The namespace is none.
    """
    bare = check_namespace(namespace)
    robot = _parsed(urdf_text)
    drives = [plugin for plugin in robot.iter("plugin") if _is_drive(plugin)]
    if not drives:
        return urdf_text
    for drive in drives:
        _place(drive, f"/{bare}")
    return ET.tostring(robot, encoding="unicode")


def _parsed(text: str) -> ET.Element:
    parser = ET.XMLParser(target=_NoDoctype())
    try:
        robot = ET.fromstring(text.lstrip("\ufeff \t\r\n"), parser=parser)
    except (ET.ParseError, UnicodeEncodeError) as error:
        raise DescriptionError(f"the description is not well-formed XML: {error}") from error
    if robot.tag != "robot":
        raise DescriptionError(
            f"the description begins with <{robot.tag[:80]}>; a URDF begins with <robot>"
        )
    _check_depth(robot)
    return robot


def _check_depth(robot: ET.Element) -> None:
    level = [robot]
    for _ in range(MAX_DEPTH):
        level = [child for element in level for child in element]
        if not level:
            return
    raise DescriptionError(f"the description nests tags more than {MAX_DEPTH} deep")


def _is_drive(plugin: ET.Element) -> bool:
    filename = plugin.get("filename", "")
    return DRIVE_NAME in plugin.attrib.values() or any(file in filename for file in DRIVE_FILES)


def _place(drive: ET.Element, namespace: str) -> None:
    ros = drive.find("ros")
    if ros is None:
        ros = ET.SubElement(drive, "ros")
    for child in list(ros):
        if child.tag == "namespace" or _remaps_tf(child):
            ros.remove(child)
    ET.SubElement(ros, "namespace").text = namespace
    ET.SubElement(ros, "remapping").text = f"/tf:={namespace}/tf"


def _remaps_tf(child: ET.Element) -> bool:
    old, separator, _ = (child.text or "").partition(":=")
    return child.tag == "remapping" and bool(separator) and old.strip() in ("/tf", "tf")
