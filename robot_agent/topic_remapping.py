"""Topic keys of a robot after the remapping rules of its description."""

import msgspec

from zensim.proto import keys
from zensim.proto.drive_topic_keys import resolve_cmd_vel_key, resolve_odom_key, resolve_topic_key
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.tf_joints import list_published_joints
from zensim.proto.topic_catalog import JOINT_COMMANDS, JOINT_STATES, TF
from zensim.robot_agent.mounted_sensors import list_sensor_keys
from zensim.robot_agent.robot_frames import (
    DEFAULT_JOINT_STATE_PUBLISHER,
    get_drive,
    list_moving_joints,
)


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
    """Keys of the sensors that agents simulate; see `list_sensor_keys`."""


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
