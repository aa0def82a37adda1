"""Configuration of a server, and its validation."""

import math
from contextlib import suppress
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.endpoints import DEFAULT_ENDPOINT, check_endpoint
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.names import check_name
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.settings.server_settings import ServerSettings
from zensim.proto.settings.setting import check_settings
from zensim.sim_server.physics.engine_config import EngineUnusable
from zensim.sim_server.physics.engine_proof.engine_prover import choose_proven_engine

if TYPE_CHECKING:
    # A world without network does not load zenoh.
    from zensim.proto.bus.bus_config import BusConfig

STEP_HZ = 240.0
MIN_KINEMATIC_STEP_HZ = 20.0
"""Least default step rate of a kinematic world: entities without a drive have contacts in it."""
REAL_TIME_FACTOR = 1.0
RATE_TOLERANCE = 1e-5
"""Relative, of the quotient of two rates: a step is a whole number of ns, also in a journal."""


class ConfigError(ValueError):
    """A configuration with which the server cannot start."""


class WorldAlreadyServed(Exception):
    """Another server has this world."""


class ServerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of a server: world, rates, network, engine."""

    bus: "BusConfig | None" = None
    """None = no network."""
    world_name: str = "default"
    settings: ServerSettings = ServerSettings()
    requested: "ServerConfig | None" = None
    """The configuration before the world file completed it."""
    journal: str = ""
    """Folder of the journal; empty = no journal."""
    keeps_inputs: bool = False
    """Whether the input log begins with the server, and is kept until it has a subscriber."""
    wait_s: float = 30.0
    """Timeout of connecting to the router."""
    ros: RosSettings = NO_ROS
    mesh_http: str = ""
    """`HOST:PORT` at which meshes of descriptions are offered by http; empty = they are not."""
    metrics: str = ""
    """`[HOST:]PORT` at which health and metrics are offered by http; empty = they are not."""
    secure_folder: str = ""
    """Folder with the users of a secured server; empty = everybody may do everything."""

    @property
    def step_ns(self) -> int:
        """Length of a step; an integer, so that time does not drift."""
        return round(NANOSECONDS / find_step_rate(self))

    @property
    def control_steps(self) -> int:
        """Steps between two drive states."""
        steps = find_step_rate(self) / self.settings.pace.control_hz
        return max(1, math.ceil(steps * (1.0 - RATE_TOLERANCE)))


def find_step_rate(config: ServerConfig) -> float:
    """Find the step rate [Hz] of a world whose file has none."""
    return config.settings.pace.choose_step_rate(_find_usual_step_rate(config))


def _find_usual_step_rate(config: ServerConfig) -> float:
    """Find the step rate [Hz] where neither the configuration nor the world file has one.

    Kinematic robots move along exact arcs, so that more than one step between two commands changes
    nothing: their world steps at the control rate, or at its least multiple from 20 Hz on.
    """
    if config.settings.physics.dynamics != "kinematic":
        return STEP_HZ
    control_hz = config.settings.pace.control_hz
    multiple = math.ceil(MIN_KINEMATIC_STEP_HZ / control_hz * (1.0 - RATE_TOLERANCE))
    return min(STEP_HZ, control_hz * max(1, multiple))


def validate_config(config: ServerConfig) -> ServerConfig:
    """Return the configuration if a server can start with it.

    Raises:
        ConfigError: A value is out of range, or its engine is missing or fails its proof.
    """
    try:
        check_name(config.world_name, "world")
        check_settings(config.settings)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    try:
        choose_proven_engine(config.settings.physics)
    except EngineUnusable as error:
        raise ConfigError(str(error)) from error
    if config.mesh_http:
        to_mesh_endpoint(config.mesh_http)
    return config


def to_mesh_endpoint(address: str) -> str:
    """Write an address of meshes as an endpoint, whose rules hold for it.

    Raises:
        ConfigError: It is not `HOST:PORT`.
    """
    with suppress(ValueError):
        endpoint = check_endpoint(f"tcp/{address}")
        if address.rpartition(":")[2].isdecimal():
            return endpoint
    raise ConfigError(
        f"`mesh_http` {address[:80]!r} is not valid; use HOST:PORT, as 127.0.0.1:8090"
    )


def fill_pace(
    config: ServerConfig, *, step_s: float | None, real_time_factor: float | None
) -> ServerConfig:
    """Complete step rate and speed from the world file, or with defaults."""
    usual_hz = 1.0 / step_s if step_s else _find_usual_step_rate(config)
    usual_factor = REAL_TIME_FACTOR if real_time_factor is None else real_time_factor
    return _complete_pace(config, usual_hz, usual_factor)


def resume_pace(config: ServerConfig, *, hz: float, real_time_factor: float) -> ServerConfig:
    """Complete step rate [Hz] and speed from a journal.

    Raises:
        ConfigError: Another step rate is set.
    """
    try:
        config.settings.pace.require_step_rate(hz)
    except ValueError as error:
        raise ConfigError(str(error)) from error
    return _complete_pace(config, hz, real_time_factor)


def _complete_pace(config: ServerConfig, usual_hz: float, usual_factor: float) -> ServerConfig:
    pace = config.settings.pace.complete(usual_hz=usual_hz, usual_factor=usual_factor)
    settings = msgspec.structs.replace(config.settings, pace=pace)
    return msgspec.structs.replace(config, settings=settings)


def describe_pace(config: ServerConfig) -> str:
    """Describe rate and speed of a configuration that is complete."""
    return f"{find_step_rate(config):g} Hz, real-time factor {config.settings.pace.rtf:g}"


def make_server_bus_config(listen: str, connect: str) -> "BusConfig":
    """Configure the server's session: its own router, or a client of the one to connect to."""
    from zensim.proto.bus.bus_config import BusConfig  # noqa: PLC0415

    if connect:
        return BusConfig(mode="client", connect=(connect,))
    return BusConfig(mode="router", listen=(listen or DEFAULT_ENDPOINT,))
