"""Configuration of an agent process, and overrides of odometry and tf rates."""

from collections.abc import Sequence

import msgspec

from zensim.proto.messages.agent_messages import Claim, OnRelease
from zensim.proto.messages.model_messages import Model
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings


class RateOverrides(msgspec.Struct, frozen=True):
    """Rates [Hz, simulation time]; 0 = at every drive state, None = as described."""

    odom_hz: float | None = None
    tf_hz: float | None = None
    """None = as described, else with odometry."""


def override_rates(claims: Sequence[Claim], rates: RateOverrides) -> tuple[Claim, ...]:
    """Set the rates of the models of claims; claims that share a model still share it."""
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
    """Configuration of an agent."""

    world: str = "default"
    agent: str = ""
    """Name, unique in the world; empty = generated."""
    entities: tuple[str, ...] = ()
    pool_limit: int | None = None
    """Maximum number of robots of a pool, 0 = any; None = no pool, it drives `entities`."""
    rates: RateOverrides = RateOverrides()
    wait_s: float = 30.0
    """Time to wait for the entities at the start; after the first claim there is no limit."""
    cmd_vel_timeout_s: float = 0.5
    """Simulation time after which a robot without commands stops; 0 = never."""
    on_release: OnRelease = "stop"
    """Fate of entities when the agent ends."""
    ros: RosSettings = NO_ROS


class AgentProcessConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of an agent process; `zensim.api.prepared_start` gets it as JSON."""

    endpoint: str
    """Of a router or server."""
    config: AgentConfig
    is_quiet: bool = False
    """Whether only warnings are logged."""
