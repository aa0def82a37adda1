"""Configuration of an agent process, and overrides of odometry and tf rates."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

import msgspec

from zensim.proto.messages.agent_messages import Claim, OnRelease
from zensim.proto.messages.model_messages import Model
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.settings.rate_settings import RateOverrides

AS_DESCRIBED = RateOverrides()


def override_rates(
    claims: Sequence[Claim],
    rates: RateOverrides,
    by_entity: Mapping[str, RateOverrides] = MappingProxyType({}),
) -> tuple[Claim, ...]:
    """Set the rates of the models of claims; claims that share a model and rates still share it.

    Args:
        claims: Of an agent.
        rates: Of all entities but those of `by_entity`.
        by_entity: Rates of entities that have their own, by name.
    """
    models: dict[tuple[int, RateOverrides], Model] = {}
    found = []
    for claim in claims:
        own = by_entity.get(claim.entity, rates)
        if (key := (id(claim.model), own)) not in models:
            models[key] = _override_model_rates(claim.model, own)
        is_same = models[key] is claim.model
        found.append(claim if is_same else msgspec.structs.replace(claim, model=models[key]))
    return tuple(found)


def _override_model_rates(model: Model, rates: RateOverrides) -> Model:
    if (drive := model.drive) is None or rates == AS_DESCRIBED:
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
    """Endpoint of a router or server."""
    config: AgentConfig
    is_quiet: bool = False
    """Whether only warnings are logged."""
    metrics: str = ""
    """`[HOST:]PORT` at which health and metrics are offered by http; empty = they are not."""
