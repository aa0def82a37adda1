"""Which robots others command: by cmd_vel, or by orders of another client."""

from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.proto.topic_catalog import TWISTS
from zensim.spawner.client.topic_reader import read_topic

COMMAND_KEYS = ("**/cmd_vel", "*/**/cmd_vel/*/*")
"""Velocity commands on plain keys, and on those of ROS 2 with type and hash. No other key of a
robot may match: a pool takes `**/cmd_vel/**` for a subscriber of `*/odom`."""
QUEUE_DEPTH = 1000


class OtherCommands:
    """Commands of a world from anything but one client."""

    def __init__(self, bus: Bus, world: str, client: str) -> None:
        self._client = client
        self._commands = [bus.subscribe(key, QUEUE_DEPTH) for key in COMMAND_KEYS]
        self._orders = read_topic(bus, TWISTS.key(world), TwistCommands, QUEUE_DEPTH)

    def take(self) -> set[str]:
        """Find the robots that were commanded since the last call."""
        taken = [sample for one in self._commands for sample in one.take()]
        names = {find_commanded_robot(sample.key) for sample in taken}
        for orders in self._orders.take():
            if orders.client != self._client:
                names.update(orders.entities)
        return names

    def close(self) -> None:
        """End the subscriptions."""
        for one in self._commands:
            one.close()
        self._orders.close()


def find_commanded_robot(key: str) -> str:
    """Find the robot of a key of velocity commands: the chunk before `cmd_vel`."""
    chunks = key.split("/")
    return chunks[chunks.index("cmd_vel") - 1] if "cmd_vel" in chunks[1:] else ""
