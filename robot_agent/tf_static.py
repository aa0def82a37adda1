"""What never changes of where a robot's frames are: on its own topic, and on that of all robots.

A robot's own transforms begin at its odometry frame; robots that are seen together on `/tf` need
one frame above them all, that their odometry frames hang from.
"""

from collections.abc import Iterator
from functools import partial

from zensim.proto import keys
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.model_messages import Origin
from zensim.proto.messages.standard_messages import TFMessage, Time, TransformStamped
from zensim.proto.ros2.ros_graph import Topic
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.driven_base import drive_of
from zensim.robot_agent.frames import Edge, base_of
from zensim.robot_agent.odometry import world_motion
from zensim.robot_agent.outlet import Outlet
from zensim.robot_agent.tf_outlets import with_namespace
from zensim.robot_agent.transforms import turn, yaw_of


def tf_static_outlets(faces: TopicFactory, claim: Claim, fixed: TFMessage) -> list[Outlet]:
    """Declare a robot's transforms that never change."""
    outlets = []
    for key, message in tf_static_of(claim, fixed, faces.settings):
        topic = Topic(key, TFMessage, is_latched=True)
        outlets.append(
            Outlet(faces, topic, partial(_same, message), is_shared=key == keys.TF_STATIC)
        )
    return outlets


def tf_static_of(
    claim: Claim, fixed: TFMessage, ros: RosSettings
) -> Iterator[tuple[str, TFMessage]]:
    """Find which topics tell of a robot's fixed transforms, and what."""
    if ros.has_namespaced_tf and fixed.transforms:
        yield keys.robot(claim.namespace, keys.TF_STATIC), fixed
    shared = with_namespace(fixed, claim.namespace).transforms + _rooted(claim, ros.tf_root)
    if ros.has_global_tf and shared:
        yield keys.TF_STATIC, TFMessage(shared)


def _rooted(claim: Claim, root: str) -> tuple[TransformStamped, ...]:
    """Hang a robot's odometry frame, its namespace before it, from the shared frame.

    Args:
        claim: The robot.
        root: The shared frame; empty for none.

    Returns:
        One transform that never changes; none without a root, or when tf has no odometry frame.
    """
    drive = drive_of(claim.model)
    if not root or not drive.publish_odom_tf:
        return ()
    origin = Origin() if drive.encoder is None else _start(claim)
    edge = Edge(root, f"{claim.namespace}/{drive.odometry_frame}", origin)
    # Stamped 0: it holds from the beginning of time.
    return (edge.stamped(Time()),)


def _start(claim: Claim) -> Origin:
    """Find where encoders counted from: the spawn, upright."""
    if not claim.spawn_state:
        return Origin()
    base = world_motion(claim.spawn_state, base_of(claim.model).in_root)
    return Origin(base.position, turn((0.0, 0.0, 1.0), yaw_of(base.orientation)))


def _same(message: TFMessage) -> TFMessage:
    return message
