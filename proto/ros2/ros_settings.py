"""Settings of the ROS 2 endpoints: domain, distribution, tf, bridge."""

from typing import Final

import msgspec

from zensim.proto.names import check_frame
from zensim.proto.ros2.rmw_keys import OFF, parse_domain
from zensim.proto.settings.ros_choice import USUAL_TF, BridgedCommand, RosChoice, TfChoice, TfScope

DISTRIBUTION_WITHOUT_HASHES: Final = "humble"
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


def parse_ros_settings(ros: RosChoice, tf: TfChoice = USUAL_TF) -> RosSettings:
    """Parse what a user chose, but for the names of topics.

    Raises:
        ValueError: The domain or the root frame is not valid.
    """
    return RosSettings(
        domain=parse_domain(ros.ros_domain),
        has_hashes=ros.ros_distro != DISTRIBUTION_WITHOUT_HASHES,
        tf=tf.tf,
        tf_root="" if tf.tf_root == OFF else check_frame(tf.tf_root),
        is_bridged=ros.ros_bridge,
        bridge_cmd_vel=tf.ros_bridge_cmd_vel,
    )
