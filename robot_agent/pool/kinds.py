"""What robots must have in common to be driven together, and what each has of its own."""

import msgspec

from zensim.proto import keys
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.drive_messages import Drive, RosBlock
from zensim.proto.messages.model_messages import Model, Origin
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.robot_agent.driven_base import drive_of
from zensim.robot_agent.frames import ALL_JOINTS, base_of, moving_joints, published_joints
from zensim.robot_agent.remapping import command_key, odometry_key, topic_key


class Topics(msgspec.Struct, frozen=True):
    """Where one robot hears and tells; empty where it does not."""

    cmd_vel: str
    odom: str = ""
    tf: str = ""
    joint_states: str = ""
    shared_tf: str = ""
    """The same for all robots."""


class Kind(msgspec.Struct, frozen=True):
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
    patterns: Topics
    """Of the topics' keys."""


def topics_of(claim: Claim, ros: RosSettings = NO_ROS) -> Topics:
    """Find where a robot hears and tells."""
    namespace, model, drive = claim.namespace, claim.model, drive_of(claim.model)
    publisher = model.joint_state or ALL_JOINTS
    has_tf = drive.publish_odom_tf or bool(moving_joints(model))
    return Topics(
        command_key(namespace, drive),
        odometry_key(namespace, drive) if drive.publish_odom else "",
        topic_key(namespace, keys.TF, drive.ros) if has_tf and ros.has_namespaced_tf else "",
        topic_key(namespace, keys.JOINT_STATES, publisher.ros) if published_joints(model) else "",
        keys.TF if has_tf and ros.has_global_tf else "",
    )


def kind_of(model: Model, topics: Topics) -> Kind:
    """Find the kind of a robot."""
    drive = drive_of(model)
    index = {joint.name: place for place, joint in enumerate(model.joints)}
    pair = drive.encoder
    moving = tuple(joint.index for joint in moving_joints(model))
    publisher = model.joint_state or ALL_JOINTS
    return Kind(
        drive=_nameless(drive),
        base_in_root=base_of(model).in_root,
        joint_count=len(model.joints),
        target_count=model.target_count,
        measured=tuple(index[one.joint] for one in model.actuators if one.joint),
        encoder=(index[pair.left_joint], index[pair.right_joint]) if pair else None,
        moving=moving,
        published=published_joints(model),
        joint_states_hz=publisher.update_rate_hz,
        geometry=msgspec.msgpack.encode([model.joints[joint] for joint in moving]),
        patterns=Topics(
            *(keys.make_pattern(key) if key else "" for key in msgspec.structs.astuple(topics))
        ),
    )


def is_common(model: Model) -> bool:
    """Whether robots of this model can be driven together; the others go one by one."""
    return model.drive is not None and not model.ground_truths


def _nameless(drive: Drive) -> Drive:
    return msgspec.structs.replace(
        drive,
        odometry_frame="",
        robot_base_frame="",
        command_topic="",
        odometry_topic="",
        ros=RosBlock(),
    )
