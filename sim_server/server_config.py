"""Configuration of a server, and its validation."""

import math
from contextlib import suppress
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.endpoints import DEFAULT_ENDPOINT, check_endpoint
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.names import check_name
from zensim.proto.ros2.ros_settings import NO_ROS, RosSettings
from zensim.proto.topic_catalog import DRIVE_STATE
from zensim.sim_server.pacing.lockstep import LockstepSettings
from zensim.sim_server.physics.engine_config import EngineOptions, EngineUnusable
from zensim.sim_server.physics.engine_proof.engine_prover import choose_proven_engine

if TYPE_CHECKING:
    # A world without network does not load zenoh.
    from zensim.proto.bus import BusConfig

CONTROL_HZ = DRIVE_STATE.rate_hz
"""Default maximum rate of drive states, as the default update rate of Gazebo's drives."""
STEP_HZ = 240.0
MIN_KINEMATIC_STEP_HZ = 20.0
"""Least default step rate of a kinematic world: entities without a drive have contacts in it."""
REAL_TIME_FACTOR = 1.0
MAX_STEP_HZ = 10_000.0
RATE_TOLERANCE = 1e-5
"""Relative, of the quotient of two rates: a step is a whole number of ns, also in a journal."""
MAX_REAL_TIME_FACTOR = 1000.0
MIN_LOCKSTEP_TIMEOUT_S, MAX_LOCKSTEP_TIMEOUT_S = 0.01, 3600.0


class ConfigError(ValueError):
    """A configuration with which the server cannot start."""


class WorldAlreadyServed(Exception):
    """Another server has this world."""


class ServerConfig(msgspec.Struct, frozen=True, kw_only=True):
    """Configuration of a server: world, rates, network, engine."""

    bus: "BusConfig | None" = None
    """None = no network."""
    world: str = "default"
    world_file: str = "empty"
    step_hz: float | None = None
    """Physics rate [Hz]; None = that of the world file, or 240; see `find_default_step_hz`."""
    control_hz: float = CONTROL_HZ
    """Maximum rate of drive states [Hz, simulation time]; each one reads all bodies back."""
    real_time_factor: float | None = None
    """0 = as fast as possible; None = that of the world file, or 1."""
    model_paths: tuple[str, ...] = ()
    """Folders with models that world files include."""
    is_strict: bool = False
    """Refuse a world file with warnings."""
    allow_missing: bool = False
    """Leave out models and collisions of the world file whose file is missing."""
    is_paused: bool = False
    lockstep: LockstepSettings = LockstepSettings()
    physics: EngineOptions = EngineOptions()
    seed: int = 0
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
        return round(NANOSECONDS / (self.step_hz or find_default_step_hz(self)))

    @property
    def control_steps(self) -> int:
        """Steps between two drive states."""
        steps = (self.step_hz or find_default_step_hz(self)) / self.control_hz
        return max(1, math.ceil(steps * (1.0 - RATE_TOLERANCE)))


def find_default_step_hz(config: ServerConfig) -> float:
    """Find the step rate [Hz] where neither the configuration nor the world file has one.

    Kinematic robots move along exact arcs, so that more than one step between two commands changes
    nothing: their world steps at the control rate, or at its least multiple from 20 Hz on.
    """
    if config.physics.dynamics != "kinematic":
        return STEP_HZ
    multiple = math.ceil(MIN_KINEMATIC_STEP_HZ / config.control_hz * (1.0 - RATE_TOLERANCE))
    return min(STEP_HZ, config.control_hz * max(1, multiple))


def validate_config(config: ServerConfig) -> ServerConfig:
    """Return the configuration if a server can start with it.

    Raises:
        ConfigError: A value is out of range, or its engine is missing or fails its proof.
    """
    try:
        check_name(config.world, "world")
    except ValueError as error:
        raise ConfigError(str(error)) from error
    if config.step_hz is not None and not 1.0 <= config.step_hz <= MAX_STEP_HZ:
        raise ConfigError(f"`step_hz` {config.step_hz:g} is out of range; use 1 to {MAX_STEP_HZ:g}")
    if not 1.0 <= config.control_hz <= MAX_STEP_HZ:
        raise ConfigError(
            f"`control_hz` {config.control_hz:g} is out of range; use 1 to {MAX_STEP_HZ:g}"
        )
    factor = config.real_time_factor
    if factor is not None and not 0.0 <= factor <= MAX_REAL_TIME_FACTOR:
        raise ConfigError(
            f"`rtf` {factor:g} is out of range; "
            f"use 0 (as fast as possible) or up to {MAX_REAL_TIME_FACTOR:g}"
        )
    if not 0 <= config.seed < 1 << 64:
        raise ConfigError(f"`seed` {config.seed} is out of range; use 0 to 2^64 - 1")
    try:
        choose_proven_engine(config.physics)
    except EngineUnusable as error:
        raise ConfigError(str(error)) from error
    _check_lockstep_timeout(config.lockstep.timeout_s)
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


def _check_lockstep_timeout(timeout_s: float) -> None:
    if not MIN_LOCKSTEP_TIMEOUT_S <= timeout_s <= MAX_LOCKSTEP_TIMEOUT_S:
        raise ConfigError(
            f"`lockstep_timeout` {timeout_s:g} is out of range; use {MIN_LOCKSTEP_TIMEOUT_S:g} to "
            f"{MAX_LOCKSTEP_TIMEOUT_S:g} seconds"
        )


def fill_pace(
    config: ServerConfig, *, step_s: float | None, real_time_factor: float | None
) -> ServerConfig:
    """Complete step rate and speed from the world file, or with defaults."""
    step_hz = config.step_hz or (1.0 / step_s if step_s else find_default_step_hz(config))
    factor = REAL_TIME_FACTOR if real_time_factor is None else real_time_factor
    if config.real_time_factor is not None:
        factor = config.real_time_factor
    return msgspec.structs.replace(config, step_hz=step_hz, real_time_factor=factor)


def make_server_bus_config(listen: str, connect: str) -> "BusConfig":
    """Configure the server's session: its own router, or a client of the one to connect to."""
    from zensim.proto.bus import BusConfig  # noqa: PLC0415

    if connect:
        return BusConfig(mode="client", connect=(connect,))
    return BusConfig(mode="router", listen=(listen or DEFAULT_ENDPOINT,))
