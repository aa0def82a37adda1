"""Publisher plug-ins: joint states, and ground truth (p3d)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import GroundTruth, JointStatePublisher
from zensim.sim_server.description.model_geometry import make_origin
from zensim.sim_server.description.plugins.drive_plugin import read_frame, read_topic

if TYPE_CHECKING:
    from zensim.sim_server.description.joint_reduction import LumpedModel
    from zensim.sim_server.description.plugins.plugin_tags import PluginTags

GZ_JOINT_STATE_FILENAME = "joint-state-publisher-system"
"""System of Gazebo Sim: without joint names it publishes all joints."""
JOINT_STATE_FILENAMES = ("gazebo_ros_joint_state_publisher", GZ_JOINT_STATE_FILENAME)
JOINT_STATE_ALIASES = {"jointName": "joint_name", "updateRate": "update_rate"}
"""Spellings of the ROS 1 plug-in."""
UNUSED_JOINT_STATE_TAGS = {
    "robotNamespace": "the namespace is set by the spawn request",
    "alwaysOn": "joint states are always on",
    "topic": "joint states are on <namespace>/joint_states",
}


def read_joint_state(tags: PluginTags, lumped: LumpedModel) -> JointStatePublisher | None:
    """Read the plug-in; None, with the reason in the report, when none of its joints exists.

    Raises:
        ModelError: The update rate is not a number, or negative.
    """
    joints = [joint.name for joint in lumped.joints]
    named = [name.strip() for text in tags.texts("joint_name") for name in text.split(",")]
    if not named and GZ_JOINT_STATE_FILENAME in tags.filename:
        named = joints
    found = tuple(dict.fromkeys(name for name in named if name in joints))
    for name in named:
        if name not in joints:
            tags.report.suspicious(
                tags.label("joint_name"),
                f"joint {name[:80]!r} does not exist or is fixed; left out",
            )
    rate, ros = tags.number("update_rate", 100.0), tags.ros()
    tags.report_unread(UNUSED_JOINT_STATE_TAGS)
    if not found:
        tags.report.suspicious(tags.subject, "no joint states: no moving joint is named")
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
    "robotNamespace": "the namespace is set by the spawn request",
}
WORLD_FRAMES = ("world", "map")


def read_ground_truth(tags: PluginTags, lumped: LumpedModel) -> GroundTruth | None:
    """Read the plug-in; None, with the reason in the report, when its link does not exist.

    Raises:
        ModelError: A value is not a number, or a rate or a noise is negative.
    """
    links = {link.name for link in lumped.links} | {frame.name for frame in lumped.frames}
    body = tags.text("body_name", "")
    frame = read_frame(tags, "frame_name", WORLD_FRAMES[0])
    truth = GroundTruth(
        body=body,
        frame_id=frame,
        update_rate_hz=tags.number("update_rate", 0.0),
        topic=read_topic(tags, "topic_name", "odom") or "odom",
        offset=make_origin(tags.vector("xyz_offset"), tags.vector("rpy_offset")),
        noise=tags.number("gaussian_noise", 0.0),
        ros=tags.ros(),
    )
    tags.report_unread(UNUSED_GROUND_TRUTH_TAGS)
    if body not in links:
        tags.report.suspicious(tags.subject, f"no ground truth: {body[:80]!r} is not a link")
        return None
    if frame not in (*WORLD_FRAMES, *links):
        tags.report.suspicious(
            tags.label("frame_name"), f"{frame!r} is not a link; poses are in the world"
        )
    return truth
