"""What an agent is told when it starts."""

import msgspec

from zensim.proto.messages.agent_messages import OnRelease
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.robot_agent.rates import Rates


class AgentConfig(msgspec.Struct, frozen=True, kw_only=True):
    """What to drive, and how."""

    world: str = "default"
    agent: str = ""
    """Unique in the world; empty when the process makes one up."""
    entities: tuple[str, ...] = ()
    pool_limit: int | None = None
    """As a pool: most robots that it drives, 0 = any number; None = it drives its entities."""
    rates: Rates = Rates()
    wait_s: float = 30.0
    """How long to wait for the entities at the start; once it had them, it waits for ever."""
    cmd_vel_timeout_s: float = 0.5
    """Simulation time after which a robot that hears nothing stands still; 0 = never."""
    on_release: OnRelease = "stop"
    """What becomes of an entity when the agent is gone."""
    ros: RosSettings = NO_ROS


class AgentStart(msgspec.Struct, frozen=True, kw_only=True):
    """All that a process needs to be an agent; as JSON it is handed to `zensim.deploy.ready`."""

    endpoint: str
    """Router or server to join."""
    config: AgentConfig
    is_quiet: bool = False
    """Whether warnings only are logged."""
