"""Configuration of a sensor process."""

import msgspec

from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings


class SensorProcessConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of a sensor process; `zensim.api.prepared_start` gets it as JSON."""

    endpoint: str
    """Endpoint of a router or server."""
    world: str = "default"
    name: str = ""
    """Unique in the world; empty = generated."""
    is_always_on: bool = False
    """Whether scene states are subscribed to without subscribers, too, as for recorders."""
    wait_s: float = 30.0
    """Time to wait for the router or server at the start."""
    ros: RosSettings = NO_ROS
    is_quiet: bool = False
    """Whether only warnings are logged."""
    metrics: str = ""
    """`[HOST:]PORT` at which health and metrics are offered by http; empty = they are not."""
