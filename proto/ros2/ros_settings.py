"""Settings of the ROS 2 endpoints: domain, distribution, tf, bridge."""

from typing import Final, Literal, get_args

import msgspec

from zensim.proto.names import check_frame
from zensim.proto.ros2.rmw_keys import OFF, parse_domain

TfScope = Literal["global", "namespaced", "both"]
"""Transforms on `/tf`, with the namespace before their frames, or on `/ns/tf`."""
DISTRIBUTION_WITHOUT_HASHES: Final = "humble"
DISTRIBUTIONS: Final = ("humble", "iron", "jazzy", "kilted", "lyrical", "rolling")


BridgedCommand = Literal["twist", "twist_stamped"]
BRIDGED_COMMANDS: Final[dict[BridgedCommand, str]] = {
    "twist": "geometry_msgs/msg/Twist",
    "twist_stamped": "geometry_msgs/msg/TwistStamped",
}
PARAMETERS: Final = "parameters"
"""Stands for the parameter services among the names of topics."""
SINCE_IRON: Final = {"sensor_msgs/msg/Range": 4}
"""Bytes of the last fields of messages that humble does not have: `variance`."""


class RosSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Settings of the ROS 2 endpoints of a program."""

    domain: int | None = 0
    """None = no ROS 2 endpoints."""
    has_hashes: bool = True
    """Whether keys have type hashes; False for humble."""
    tf: TfScope = "both"
    tf_root: str = "world"
    """Parent of the odometry frames on `/tf_static`; empty for none."""
    is_bridged: bool = False
    """Whether topics and services are announced to zenoh-bridge-ros2dds."""

    topics: tuple[str, ...] = ()
    """Topics of robots that are in ROS 2, by name, and `PARAMETERS`; empty = all."""
    bridge_cmd_vel: BridgedCommand = "twist"
    """Type of `cmd_vel` that bridges see: they route one type a topic name."""

    @property
    def has_node_services(self) -> bool:
        """Whether each node has the parameter services of ROS 2, seven tokens a node."""
        return self.has_topic(PARAMETERS)

    def has_topic(self, name: str) -> bool:
        """Whether a topic of robots is in ROS 2; all others have no name here, and are."""
        return not (name and self.topics) or name in self.topics

    def hides_from_bridge(self, ros_type: str) -> bool:
        """Whether a subscription of this type is not announced to bridges."""
        commands = BRIDGED_COMMANDS.values()
        return ros_type in commands and ros_type != BRIDGED_COMMANDS[self.bridge_cmd_vel]

    def count_surplus_bytes(self, ros_type: str) -> int:
        """Count the bytes at the end of a message that the distribution does not know."""
        return 0 if self.has_hashes else SINCE_IRON.get(ros_type, 0)

    @property
    def has_global_tf(self) -> bool:
        """Whether transforms are published on `/tf`."""
        return self.tf != "namespaced"

    @property
    def has_namespaced_tf(self) -> bool:
        """Whether transforms are published on `/ns/tf`."""
        return self.tf != "global"


NO_ROS: Final = RosSettings(domain=None, tf="namespaced")


def parse_ros_settings(
    domain: str, distribution: str, tf: str = "both", tf_root: str = "world", *, is_bridged: bool
) -> RosSettings:
    """Parse command-line options.

    Raises:
        ValueError: A value is unknown, or the domain or the root frame is not valid.
    """
    if distribution not in DISTRIBUTIONS:
        raise ValueError(
            f"`ros_distro` {distribution!r} is unknown; use {', '.join(DISTRIBUTIONS)}"
        )
    return RosSettings(
        domain=parse_domain(domain),
        has_hashes=distribution != DISTRIBUTION_WITHOUT_HASHES,
        tf=_parse_tf_scope(tf),
        tf_root="" if tf_root == OFF else check_frame(tf_root),
        is_bridged=is_bridged,
    )


def to_cli_arguments(settings: RosSettings) -> tuple[str, ...]:
    """Write the settings as command-line options of a server, without those of tf."""
    domain = OFF if settings.domain is None else str(settings.domain)
    return (
        *("--ros-domain", domain),
        *(() if settings.has_hashes else ("--ros-distro", DISTRIBUTION_WITHOUT_HASHES)),
        *(("--ros-bridge",) if settings.is_bridged else ()),
        *(("--ros-topics", ",".join(settings.topics)) if settings.topics else ()),
    )


def _parse_tf_scope(text: str) -> TfScope:
    for known in get_args(TfScope):
        if known == text:
            return known  # type: ignore[no-any-return]
    raise ValueError(f"`tf` {text!r} is unknown; use {', '.join(get_args(TfScope))}")
