"""Publisher plug-ins: joint states, and ground truth (p3d)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import GroundTruth, JointStatePublisher, Origin
from zensim.proto.rigid_transforms import from_rpy
from zensim.sim_server.description.plugins.drive_plugin import read_frame, read_topic

if TYPE_CHECKING:
    from collections.abc import Mapping

    from zensim.proto.messages.model_messages import Joint
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

GZ_JOINT_STATE_FILENAME = "joint-state-publisher-system"
"""Of Gazebo Sim: it publishes all joints when it names none."""
JOINT_STATE_FILENAMES = ("gazebo_ros_joint_state_publisher", GZ_JOINT_STATE_FILENAME)
JOINT_STATE_ALIASES = {"jointName": "joint_name", "updateRate": "update_rate"}
"""Spellings of the ROS 1 plug-in."""
UNUSED_JOINT_STATE_TAGS = {
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
    if not named and GZ_JOINT_STATE_FILENAME in tags.filename:
        named = list(joints)
    found = tuple(dict.fromkeys(name for name in named if name in joints))
    for name in named:
        if name not in joints:
            tags.report.suspicious(
                f"{tags.subject}: <joint_name>",
                f"joint {name[:80]!r} does not exist or is fixed; left out",
            )
    rate, ros = tags.number("update_rate", 100.0), tags.ros()
    tags.report_unread(UNUSED_JOINT_STATE_TAGS)
    if not found:
        tags.report.suspicious(tags.subject, "no joint states: it names no joint that moves")
        return None
    return JointStatePublisher(joints=found, update_rate_hz=rate, ros=ros)


GROUND_TRUTH_FILENAMES = ("gazebo_ros_p3d",)
GROUND_TRUTH_ALIASES = {
    "bodyName": "body_name",
    "frameName": "frame_name",
    "gaussianNoise": "gaussian_noise",
    "rpyOffset": "rpy_offset",
    "rpyOffsets": "rpy_offset",
    "rpy_offsets": "rpy_offset",
    "topicName": "topic_name",
    "updateRate": "update_rate",
    "xyzOffset": "xyz_offset",
    "xyzOffsets": "xyz_offset",
    "xyz_offsets": "xyz_offset",
}
"""Spellings of the ROS 1 plug-in."""
UNUSED_GROUND_TRUTH_TAGS = {
    "alwaysOn": "ground truth is always on",
    "always_on": "ground truth is always on",
    "robotNamespace": "the namespace is that of the spawn request",
}
WORLD_FRAMES = ("world", "map")


def read_ground_truth(tags: PluginTags, lumped: LumpedModel) -> GroundTruth | None:
    """Read the plug-in; None, with the reason noted, where it names no link.

    Raises:
        ModelError: A number is none, or a rate or a noise is negative.
    """
    links = {link.name for link in lumped.links} | {frame.name for frame in lumped.frames}
    body = tags.text("body_name", "")
    frame = read_frame(tags, "frame_name", WORLD_FRAMES[0])
    x, y, z = tags.vector("xyz_offset")
    roll, pitch, yaw = tags.vector("rpy_offset")
    truth = GroundTruth(
        body=body,
        frame_id=frame,
        update_rate_hz=tags.number("update_rate", 0.0),
        topic=read_topic(tags, "topic_name", "odom", is_new=False) or "odom",
        offset=Origin((x, y, z), from_rpy(roll, pitch, yaw)),
        noise=tags.number("gaussian_noise", 0.0),
        ros=tags.ros(),
    )
    tags.report_unread(UNUSED_GROUND_TRUTH_TAGS)
    if body not in links:
        tags.report.suspicious(tags.subject, f"no ground truth: {body[:80]!r} is no link")
        return None
    if frame not in (*WORLD_FRAMES, *links):
        tags.report.suspicious(
            f"{tags.subject}: <frame_name>", f"{frame!r} is no link; poses are in the world"
        )
    return truth
