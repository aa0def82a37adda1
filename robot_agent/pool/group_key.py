"""What robots must have in common to be one group, and the topic keys of each robot."""

import msgspec

from zensim.proto import keys
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.drive_messages import Drive, RosBlock
from zensim.proto.messages.model_messages import Model, Origin
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.topic_catalog import JOINT_STATES, TF
from zensim.robot_agent.base_controller import get_drive
from zensim.robot_agent.robot_frames import (
    DEFAULT_JOINT_STATE_PUBLISHER,
    find_base_frame,
    list_moving_joints,
    list_published_joints,
)
from zensim.robot_agent.topic_remapping import (
    resolve_cmd_vel_key,
    resolve_odom_key,
    resolve_topic_key,
)


class RobotTopicKeys(msgspec.Struct, frozen=True):
    """Where one robot hears and tells; empty where it does not."""

    cmd_vel: str
    odom: str = ""
    tf: str = ""
    joint_states: str = ""
    shared_tf: str = ""
    """The same for all robots."""


class GroupKey(msgspec.Struct, frozen=True):
    """One way to be driven and to tell of it, names and frames apart."""

    drive: Drive
    """Without what it calls things."""
    base_in_root: Origin
    joint_count: int
    target_count: int
    measured: tuple[int, ...]
    """Joints of the actuators."""
    encoder: tuple[int, int] | None
    """Left and right wheel, when they tell the odometry."""
    moving: tuple[int, ...]
    """Joints that tf tells of."""
    published: tuple[int, ...]
    """Joints whose states are told."""
    joint_states_hz: float
    geometry: bytes
    """Of the joints that tf tells of."""
    patterns: RobotTopicKeys
    """Of the topics' keys."""


def find_topic_keys(claim: Claim, ros: RosSettings = NO_ROS) -> RobotTopicKeys:
    """Find where a robot hears and tells."""
    namespace, model, drive = claim.namespace, claim.model, get_drive(claim.model)
    publisher = model.joint_state or DEFAULT_JOINT_STATE_PUBLISHER
    has_tf = drive.publish_odom_tf or bool(list_moving_joints(model))
    return RobotTopicKeys(
        resolve_cmd_vel_key(namespace, drive),
        resolve_odom_key(namespace, drive) if drive.publish_odom else "",
        resolve_topic_key(namespace, TF.suffix, drive.ros)
        if has_tf and ros.has_namespaced_tf
        else "",
        resolve_topic_key(namespace, JOINT_STATES.suffix, publisher.ros)
        if list_published_joints(model)
        else "",
        TF.suffix if has_tf and ros.has_global_tf else "",
    )


def make_group_key(model: Model, topics: RobotTopicKeys) -> GroupKey:
    """Find the kind of a robot."""
    drive = get_drive(model)
    index = {joint.name: place for place, joint in enumerate(model.joints)}
    pair = drive.encoder
    moving = tuple(joint.index for joint in list_moving_joints(model))
    publisher = model.joint_state or DEFAULT_JOINT_STATE_PUBLISHER
    return GroupKey(
        drive=_strip_names(drive),
        base_in_root=find_base_frame(model).pose_in_root,
        joint_count=len(model.joints),
        target_count=model.target_count,
        measured=tuple(index[one.joint] for one in model.actuators if one.joint),
        encoder=(index[pair.left_joint], index[pair.right_joint]) if pair else None,
        moving=moving,
        published=list_published_joints(model),
        joint_states_hz=publisher.update_rate_hz,
        geometry=msgspec.msgpack.encode([model.joints[joint] for joint in moving]),
        patterns=RobotTopicKeys(
            *(keys.make_pattern(key) if key else "" for key in msgspec.structs.astuple(topics))
        ),
    )


def can_be_grouped(model: Model) -> bool:
    """Whether robots of this model can be driven together; the others go one by one."""
    return model.drive is not None and not model.ground_truths


def _strip_names(drive: Drive) -> Drive:
    return msgspec.structs.replace(
        drive,
        odometry_frame="",
        robot_base_frame="",
        command_topic="",
        odometry_topic="",
        ros=RosBlock(),
    )
