"""Topic keys of a robot after the remapping rules of its description."""

import msgspec

from zensim.proto import keys
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.drive_messages import DriveSettings, RosBlock
from zensim.proto.names import InvalidName, check_namespace
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.tf_joints import list_published_joints
from zensim.proto.topic_catalog import CMD_VEL, JOINT_COMMANDS, JOINT_STATES, ODOM, TF
from zensim.robot_agent.mounted_sensors import list_sensor_keys
from zensim.robot_agent.robot_frames import (
    DEFAULT_JOINT_STATE_PUBLISHER,
    get_drive,
    list_moving_joints,
)

ABSOLUTE_TOPICS = frozenset({TF.suffix})
"""Gazebo's plug-ins publish these outside any namespace; rules name them with a slash."""


class RobotTopicKeys(msgspec.Struct, frozen=True):
    """Topic keys of one robot; empty if it has no such topic."""

    cmd_vel: str
    odom: str = ""
    tf: str = ""
    joint_states: str = ""
    joint_commands: str = ""
    shared_tf: str = ""
    """The same for all robots."""
    sensors: tuple[str, ...] = ()
    """Of the sensors that agents simulate; see `list_sensor_keys`."""


def find_topic_keys(claim: Claim, ros: RosSettings = NO_ROS) -> RobotTopicKeys:
    """Find the topic keys of a robot."""
    namespace, model, drive = claim.namespace, claim.model, get_drive(claim.model)
    publisher = model.joint_state or DEFAULT_JOINT_STATE_PUBLISHER
    has_tf = drive.publish_odom_tf or bool(list_moving_joints(model))
    tf = resolve_topic_key(namespace, TF.suffix, drive.ros)
    joint_states = resolve_topic_key(namespace, JOINT_STATES.suffix, publisher.ros)
    return RobotTopicKeys(
        cmd_vel=resolve_cmd_vel_key(namespace, drive),
        odom=resolve_odom_key(namespace, drive) if drive.publish_odom else "",
        tf=tf if has_tf and ros.has_namespaced_tf else "",
        joint_states=joint_states if list_published_joints(model) else "",
        joint_commands=keys.robot(namespace, JOINT_COMMANDS.suffix)
        if model.joint_controllers
        else "",
        shared_tf=TF.suffix if has_tf and ros.has_global_tf else "",
        sensors=list_sensor_keys(model, namespace),
    )


def resolve_topic_key(namespace: str, topic: str, ros: RosBlock) -> str:
    """Find a topic's key; the first matching rule applies.

    A rule that gives no valid key is skipped. The namespace is that of the entity: as in Gazebo, a
    spawn overrides the namespace of plug-ins.

    Source: ROS 2 design, remapping of names.
    """
    wanted = f"/{topic}" if topic in ABSOLUTE_TOPICS else f"/{namespace}/{topic}"
    for rule in ros.remappings:
        old, _, new = (part.strip() for part in rule.partition(":="))
        if _expand_name(old, namespace) != wanted:
            continue
        try:
            return check_namespace(_expand_name(new, namespace))
        except InvalidName:
            continue
    return keys.robot(namespace, topic)


def resolve_cmd_vel_key(namespace: str, drive: DriveSettings) -> str:
    """Find the key of a drive's velocity commands."""
    return _resolve_drive_key(namespace, CMD_VEL.suffix, drive.command_topic, drive)


def resolve_odom_key(namespace: str, drive: DriveSettings) -> str:
    """Find the key of a drive's odometry."""
    return _resolve_drive_key(namespace, ODOM.suffix, drive.odometry_topic, drive)


def _resolve_drive_key(namespace: str, default: str, described: str, drive: DriveSettings) -> str:
    key = resolve_topic_key(namespace, default, drive.ros)
    is_remapped = key != keys.robot(namespace, default)
    if is_remapped or not described or drive.compat == "gazebo11":
        return key
    return resolve_topic_key(namespace, described, drive.ros)


def _expand_name(name: str, namespace: str) -> str:
    return name if name.startswith(("/", "~")) else f"/{namespace}/{name}"
