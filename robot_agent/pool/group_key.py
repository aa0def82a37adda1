"""What robots must have in common to be driven as one group."""

from collections.abc import Iterable

import msgspec

from zensim.proto import keys
from zensim.proto.messages.agent_messages import Claim
from zensim.proto.messages.drive_messages import Drive, RosBlock
from zensim.proto.messages.model_messages import Origin
from zensim.proto.messages.sensing_messages import Environment
from zensim.proto.tf_joints import list_published_joints
from zensim.robot_agent.mounted_sensors import MountedSensor, mount_sensors
from zensim.robot_agent.robot_frames import (
    DEFAULT_JOINT_STATE_PUBLISHER,
    find_base_frame,
    get_drive,
    list_moving_joints,
)
from zensim.robot_agent.topic_remapping import RobotTopicKeys


class GroupKey(msgspec.Struct, frozen=True):
    """Drive, joints and topics that the robots of a group share, without names and frames."""

    drive: Drive
    """Drive without names of frames and topics."""
    base_in_root: Origin
    joint_count: int
    target_count: int
    """Number of targets of the drive."""
    measured: tuple[int, ...]
    """Joints of the actuators."""
    encoder: tuple[int, int] | None
    """Left and right wheel of encoder odometry."""
    moving: tuple[int, ...]
    """Joints in tf."""
    published: tuple[int, ...]
    """Joints in joint states."""
    joint_states_hz: float
    geometry: bytes
    """Encoded joints in tf."""
    patterns: RobotTopicKeys
    """Patterns of the topic keys."""
    sensors: tuple[MountedSensor, ...] = ()
    """Sensors that agents simulate."""
    environment: Environment = Environment()
    """What these sensors know of the world."""
    joint_target_count: int = 0
    """Number of targets of controlled joints."""


class GroupKeys:
    """The group keys of a pool: one object for equal ones, as each takes 2 KiB."""

    def __init__(self) -> None:
        self._keys: dict[GroupKey, GroupKey] = {}
        self._made: dict[tuple[int, int, RobotTopicKeys], tuple[Claim, GroupKey]] = {}
        """Keys by model, environment and patterns; with the claim, which keeps the first two."""

    def find(self, claim: Claim, topic_keys: RobotTopicKeys) -> GroupKey:
        """Find the group key of a robot."""
        known = id(claim.model), id(claim.environment), _make_patterns(topic_keys)
        if known not in self._made:
            made = make_group_key(claim, topic_keys)
            self._made[known] = claim, self._keys.setdefault(made, made)
        return self._made[known][1]

    def keep(self, keys: Iterable[GroupKey]) -> None:
        """Forget all but these."""
        self._keys = {key: key for key in keys}
        self._made.clear()


def make_group_key(claim: Claim, topic_keys: RobotTopicKeys) -> GroupKey:
    """Make the group key of a robot."""
    model = claim.model
    drive = get_drive(model)
    index = {joint.name: place for place, joint in enumerate(model.joints)}
    pair = drive.encoder
    moving = tuple(joint.index for joint in list_moving_joints(model))
    publisher = model.joint_state or DEFAULT_JOINT_STATE_PUBLISHER
    return GroupKey(
        drive=_strip_names(drive),
        base_in_root=find_base_frame(model).pose_in_root,
        joint_count=len(model.joints),
        target_count=sum(one.width for one in model.drive_actuators),
        measured=tuple(index[one.joint] for one in model.drive_actuators if one.joint),
        encoder=(index[pair.left_joint], index[pair.right_joint]) if pair else None,
        moving=moving,
        published=list_published_joints(model),
        joint_states_hz=publisher.update_rate_hz,
        geometry=msgspec.msgpack.encode([model.joints[joint] for joint in moving]),
        patterns=_make_patterns(topic_keys),
        sensors=mount_sensors(model),
        environment=claim.environment,
        joint_target_count=sum(one.width for one in model.joint_actuators),
    )


def _make_patterns(found: RobotTopicKeys) -> RobotTopicKeys:
    return RobotTopicKeys(
        cmd_vel=_make_pattern(found.cmd_vel),
        odom=_make_pattern(found.odom),
        tf=_make_pattern(found.tf),
        joint_states=_make_pattern(found.joint_states),
        shared_tf=_make_pattern(found.shared_tf),
        sensors=tuple(map(_make_pattern, found.sensors)),
    )


def _make_pattern(key: str) -> str:
    return keys.make_pattern(key) if key else ""


def _strip_names(drive: Drive) -> Drive:
    return msgspec.structs.replace(
        drive,
        odometry_frame="",
        robot_base_frame="",
        command_topic="",
        odometry_topic="",
        ros=RosBlock(),
    )
