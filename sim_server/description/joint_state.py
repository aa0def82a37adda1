"""The joint state plug-in: which joints, how often."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import JointStatePublisher

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zensim.proto.messages.model_messages import Joint
    from zensim.sim_server.description.plugin_tags import PluginTags

GZ = "joint-state-publisher-system"
"""Of Gazebo Sim: it publishes all joints when it names none."""
FILENAMES = ("gazebo_ros_joint_state_publisher", GZ)
ALIASES = {"jointName": "joint_name", "updateRate": "update_rate"}
"""Spellings of the ROS 1 plug-in."""
UNUSED = {
    "robotNamespace": "the namespace is that of the spawn request",
    "alwaysOn": "joint states are always on",
    "topic": "joint states are on <namespace>/joint_states",
}


def read_joint_state(tags: PluginTags, joints: Mapping[str, Joint]) -> JointStatePublisher | None:
    """Read the plug-in; None, with the reason noted, when no joint that it names exists.

    Args:
        tags: Of the plug-in.
        joints: Of the robot once lumped, by name.

    Raises:
        ModelError: The update rate is no number, or negative.
    """
    named = [name.strip() for text in tags.texts("joint_name") for name in text.split(",")]
    if not named and GZ in tags.filename:
        named = list(joints)
    found = tuple(dict.fromkeys(name for name in named if name in joints))
    for name in named:
        if name not in joints:
            tags.report.suspicious(
                f"{tags.subject}: <joint_name>",
                f"joint {name[:80]!r} does not exist or is fixed; left out",
            )
    rate, ros = tags.number("update_rate", 100.0), tags.ros()
    tags.report_unread(UNUSED)
    if not found:
        tags.report.suspicious(tags.subject, "no joint states: it names no joint that moves")
        return None
    return JointStatePublisher(joints=found, update_rate_hz=rate, ros=ros)
