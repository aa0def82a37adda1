"""Keys of a drive's topics after the remapping rules of its description."""

from zensim.proto import keys
from zensim.proto.messages.drive_messages import DriveSettings, RosBlock
from zensim.proto.names import InvalidName, check_namespace
from zensim.proto.topic_catalog import CMD_VEL, ODOM, TF

ABSOLUTE_TOPICS = frozenset({TF.suffix})
"""Gazebo's plug-ins publish these outside any namespace; rules name them with a slash."""


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
