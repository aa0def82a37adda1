"""The <ros> block of a plug-in: namespace and remappings."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import RosBlock
from zensim.proto.names import InvalidName, check_namespace

if TYPE_CHECKING:
    from lxml.etree import _Element as Element

    from zensim.sim_server.description.report import Report

UNUSED = {
    "argument": "there is no ROS node to pass it to",
    "parameter": "there is no ROS node to pass it to",
    "qos": "quality of service is the network's own",
}
KNOWN = ("namespace", "remapping", *UNUSED)


def read_ros_block(ros: Element, *, subject: str, report: Report) -> RosBlock:
    """Read a <ros> block; what cannot be used is noted and left out."""
    namespaces: list[str] = []
    remappings: list[str] = []
    for child in ros:
        text = (child.text or "").strip()
        if child.tag == "namespace":
            namespaces.append(text)
        elif child.tag == "remapping":
            remappings += _remapping(text, subject=subject, report=report)
        elif child.tag in UNUSED:
            report.ignored(f"{subject}: <{child.tag}>", UNUSED[child.tag])
        else:
            report.unread_tag(f"{subject}: <ros>", child.tag, KNOWN)
    namespace = _namespace(namespaces, subject=subject, report=report)
    return RosBlock(namespace=namespace, remappings=tuple(remappings))


def _remapping(text: str, *, subject: str, report: Report) -> list[str]:
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


def _namespace(written: list[str], *, subject: str, report: Report) -> str:
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
