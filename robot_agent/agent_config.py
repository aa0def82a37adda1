"""Configuration of an agent process, and overrides of odometry and tf rates."""

from collections.abc import Sequence

import msgspec

from zensim.proto.messages.agent_messages import Claim, OnRelease
from zensim.proto.messages.model_messages import Model
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings


class RateOverrides(msgspec.Struct, frozen=True):
    """How often [simulated Hz]; 0 = at every drive state, None = as described."""

    odom_hz: float | None = None
    tf_hz: float | None = None
    """None = as described, or else with odometry."""


def override_rates(claims: Sequence[Claim], rates: RateOverrides) -> tuple[Claim, ...]:
    """Put rates into the models of claims; those that share a model go on sharing it."""
    if rates == RateOverrides():
        return tuple(claims)
    models = {id(claim.model): _override_model_rates(claim.model, rates) for claim in claims}
    return tuple(msgspec.structs.replace(claim, model=models[id(claim.model)]) for claim in claims)


def _override_model_rates(model: Model, rates: RateOverrides) -> Model:
    if (drive := model.drive) is None:
        return model
    odom_hz = drive.odometry_rate_hz if rates.odom_hz is None else rates.odom_hz
    tf_hz = drive.tf_rate_hz if rates.tf_hz is None else rates.tf_hz
    paced = msgspec.structs.replace(drive, odometry_rate_hz=odom_hz, tf_rate_hz=tf_hz)
    return msgspec.structs.replace(model, drive=paced)


class AgentConfig(msgspec.Struct, frozen=True, kw_only=True):
    """What to drive, and how."""

    world: str = "default"
    agent: str = ""
    """Unique in the world; empty when the process makes one up."""
    entities: tuple[str, ...] = ()
    pool_limit: int | None = None
    """As a pool: most robots that it drives, 0 = any number; None = it drives its entities."""
    rates: RateOverrides = RateOverrides()
    wait_s: float = 30.0
    """How long to wait for the entities at the start; once it had them, it waits for ever."""
    cmd_vel_timeout_s: float = 0.5
    """Simulation time after which a robot that hears nothing stands still; 0 = never."""
    on_release: OnRelease = "stop"
    """What becomes of an entity when the agent is gone."""
    ros: RosSettings = NO_ROS


class AgentProcessConfig(msgspec.Struct, frozen=True, kw_only=True):
    """All that a process needs to be an agent; as JSON it is handed to `zensim.deploy.prepared_start`."""

    endpoint: str
    """Router or server to join."""
    config: AgentConfig
    is_quiet: bool = False
    """Whether warnings only are logged."""
