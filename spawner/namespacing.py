"""A robot's own namespace, written into the drive of its description."""

import xml.etree.ElementTree as ET
from collections.abc import Callable

from zensim.proto.names import check_namespace
from zensim.spawner.markup import DescriptionError, parsed

__all__ = ["DescriptionError", "namespaced", "without_namespace"]

DRIVE_FILES = ("gazebo_ros_diff_drive", "gazebo_ros_skid_steer_drive")
DRIVE_NAME = "differential_drive_controller"


def namespaced(urdf_text: str, namespace: str) -> str:
    """Give every differential drive this namespace, and a tf topic inside it.

    A drive is found by its plug-in's file or by the name `differential_drive_controller`. Its
    <ros> block is made when missing; a namespace and a remapping of /tf that it has are replaced,
    so that doing this twice is as doing it once. Without a drive the text is returned as it is.

    Args:
        urdf_text: The description, any xacro expanded.
        namespace: With or without a leading slash.

    Raises:
        DescriptionError: The text is no XML, has a DOCTYPE, or is neither URDF nor SDF.
        InvalidName: The namespace is none.
    """
    bare = check_namespace(namespace)
    return _with_each_drive(urdf_text, lambda drive: _place(drive, f"/{bare}"))


def without_namespace(urdf_text: str) -> str:
    """Take the namespace and the remapping of /tf that a drive may have away.

    What is left does for every robot of a fleet: each has the namespace that it is spawned with.

    Raises:
        DescriptionError: The text is no XML, has a DOCTYPE, or is neither URDF nor SDF.
    """
    return _with_each_drive(urdf_text, _displace)


def _with_each_drive(urdf_text: str, change: Callable[[ET.Element], None]) -> str:
    robot = parsed(urdf_text)
    drives = [plugin for plugin in robot.iter("plugin") if _is_drive(plugin)]
    for drive in drives:
        change(drive)
    return ET.tostring(robot, encoding="unicode") if drives else urdf_text


def _is_drive(plugin: ET.Element) -> bool:
    filename = plugin.get("filename", "")
    return DRIVE_NAME in plugin.attrib.values() or any(file in filename for file in DRIVE_FILES)


def _place(drive: ET.Element, namespace: str) -> None:
    _displace(drive)
    ros = drive.find("ros")
    if ros is None:
        ros = ET.SubElement(drive, "ros")
    ET.SubElement(ros, "namespace").text = namespace
    ET.SubElement(ros, "remapping").text = f"/tf:={namespace}/tf"


def _displace(drive: ET.Element) -> None:
    if (ros := drive.find("ros")) is None:
        return
    for child in list(ros):
        if child.tag == "namespace" or _remaps_tf(child):
            ros.remove(child)


def _remaps_tf(child: ET.Element) -> bool:
    old, separator, _ = (child.text or "").partition(":=")
    return child.tag == "remapping" and bool(separator) and old.strip() in ("/tf", "tf")
