"""What a sim server is told at its start, checked."""

import msgspec

from proto.bus import DEFAULT_ENDPOINT, BusConfig
from proto.header import NANOSECONDS
from proto.names import check_name

CONTROL_HZ = 100.0
"""Agents are told at this rate at most, as often as a Gazebo drive updates by default."""
MAX_STEP_HZ = 10_000.0
MAX_REAL_TIME_FACTOR = 1000.0


class ConfigError(ValueError):
    """A start that cannot work."""


class AlreadyServed(Exception):
    """Another server has this world."""


class ServerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """One world, its clock, and how it joins the network."""

    bus: BusConfig
    world: str = "default"
    world_file: str = "empty"
    step_hz: float = 240.0
    real_time_factor: float = 1.0
    """0 = as fast as it can."""
    is_paused: bool = False
    seed: int = 0

    @property
    def step_ns(self) -> int:
        """Length of a step; an integer, so that time never drifts."""
        return round(NANOSECONDS / self.step_hz)

    @property
    def control_steps(self) -> int:
        """Steps between two drive states."""
        return max(1, -int(-self.step_hz // CONTROL_HZ))


def checked(config: ServerConfig) -> ServerConfig:
    """Return the configuration if a server can start with it.

    Raises:
        ConfigError: A value is out of range.
    """
    try:
        check_name(config.world, "world")
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if not 1.0 <= config.step_hz <= MAX_STEP_HZ:
        raise ConfigError(f"--step-hz {config.step_hz:g} is out of range; use 1 to {MAX_STEP_HZ:g}")
    if not 0.0 <= config.real_time_factor <= MAX_REAL_TIME_FACTOR:
        raise ConfigError(
            f"--rtf {config.real_time_factor:g} is out of range; use 0 (flat out) or up to "
            f"{MAX_REAL_TIME_FACTOR:g}"
        )
    if config.seed < 0:
        raise ConfigError(f"--seed {config.seed} is negative; use 0 or more")
    return config


def server_bus(listen: str, connect: str) -> BusConfig:
    """Say how a server joins: it is the router itself unless it connects to one."""
    if connect:
        return BusConfig(mode="client", connect=(connect,))
    return BusConfig(mode="router", listen=(listen or DEFAULT_ENDPOINT,))
