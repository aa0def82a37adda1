"""The ground truth plug-in, p3d: which link's true odometry is published, where and how often."""

from __future__ import annotations

from typing import TYPE_CHECKING

from zensim.proto.messages.model_messages import GroundTruth, Origin
from zensim.proto.rotation import from_rpy
from zensim.sim_server.description.drive_tags import read_frame, read_topic

if TYPE_CHECKING:
    from zensim.sim_server.description.lumping import Lumped
    from zensim.sim_server.description.plugin_tags import PluginTags

FILENAMES = ("gazebo_ros_p3d",)
ALIASES = {
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
UNUSED = {
    "alwaysOn": "ground truth is always on",
    "always_on": "ground truth is always on",
    "robotNamespace": "the namespace is that of the spawn request",
}
WORLD = ("world", "map")


def read_ground_truth(tags: PluginTags, lumped: Lumped) -> GroundTruth | None:
    """Read the plug-in; None, with the reason noted, where it names no link.

    Raises:
        ModelError: A number is none, or a rate or a noise is negative.
    """
    links = {link.name for link in lumped.links} | {frame.name for frame in lumped.frames}
    body = tags.text("body_name", "")
    frame = read_frame(tags, "frame_name", WORLD[0])
    x, y, z = tags.vector("xyz_offset")
    roll, pitch, yaw = tags.vector("rpy_offset")
    qx, qy, qz, qw = from_rpy(roll, pitch, yaw).tolist()
    truth = GroundTruth(
        body=body,
        frame_id=frame,
        update_rate_hz=tags.number("update_rate", 0.0),
        topic=read_topic(tags, "topic_name", "odom", is_new=False) or "odom",
        offset=Origin((x, y, z), (qx, qy, qz, qw)),
        noise=tags.number("gaussian_noise", 0.0),
        ros=tags.ros(),
    )
    tags.report_unread(UNUSED)
    if body not in links:
        tags.report.suspicious(tags.subject, f"no ground truth: {body[:80]!r} is no link")
        return None
    if frame not in (*WORLD, *links):
        tags.report.suspicious(
            f"{tags.subject}: <frame_name>", f"{frame!r} is no link; poses are in the world"
        )
    return truth
