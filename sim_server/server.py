"""The composition root: bus, engine, world and loop of one server process."""

import logging
import time
from collections.abc import Callable
from contextlib import ExitStack

from proto import keys
from proto.bus import Bus, NoServer
from proto.catalog import INFO
from proto.header import NANOSECONDS
from proto.joining import join
from proto.telemetry import InfoRequest
from sim_server.assets import AssetStore
from sim_server.config import AlreadyServed, ServerConfig, checked, paced
from sim_server.descriptions import ReadElsewhere
from sim_server.desk import Desk
from sim_server.inbox import BusInbox
from sim_server.lockstep import Lockstep
from sim_server.loop import Loop
from sim_server.meter import Meter
from sim_server.outlets import BusOutlet
from sim_server.physics.engine import EngineConfig
from sim_server.physics.pybullet_engine import PyBulletEngine
from sim_server.reader import Reader
from sim_server.world import World
from sim_server.world_files import LoadedWorld, doubts, furnish, load_world

ASK_TIMEOUT_S = 2.0
READER_START_S, READER_POLL_S = 30.0, 0.005
LOG = logging.getLogger(__name__)


class WallClock:
    """The host's monotonic clock."""

    def now_ns(self) -> int:
        """See `Clock`."""
        return time.monotonic_ns()

    def sleep(self, seconds: float) -> None:
        """See `Clock`."""
        time.sleep(seconds)


def serve(
    config: ServerConfig,
    should_stop: Callable[[], bool],
    on_ready: Callable[[Bus, ServerConfig], None],
) -> None:
    """Run a server until told to stop.

    Raises:
        ConfigError: The configuration cannot work.
        AlreadyServed: Another server has this world.
        BusError: The network cannot be joined.
    """
    checked(config)
    loaded = load_world(config.world_file, config.model_paths, is_strict=config.is_strict)
    for fault in doubts(loaded.model.report):
        LOG.warning("world=%s %s", config.world_file, fault)
    pace = loaded.model.pace
    config = paced(config, step_s=pace.step_s, real_time_factor=pace.real_time_factor)
    with join(config.bus, config.wait_s) as bus:
        if _is_served(bus, config.world):
            raise AlreadyServed(
                f"world '{config.world}' already has a server at {bus.endpoint}; "
                "stop it, or use --world-name with another"
            )
        _run(config, loaded, bus, should_stop, on_ready)


def _is_served(bus: Bus, world: str) -> bool:
    """Whether another server answers for a world; a router of our own is too young to have one."""
    if bus.config.mode == "router":
        return False
    try:
        bus.call(INFO, InfoRequest(), world=world, timeout_s=ASK_TIMEOUT_S)
    except NoServer:
        return bool(bus.alive(keys.alive_server(world)))
    except TimeoutError:
        return True
    return True


def _run(
    config: ServerConfig,
    loaded: LoadedWorld,
    bus: Bus,
    should_stop: Callable[[], bool],
    on_ready: Callable[[Bus, ServerConfig], None],
) -> None:
    clock = WallClock()
    with ExitStack() as ending:
        store = AssetStore()
        ending.callback(store.close)
        reader = Reader(store, clock.now_ns)
        ending.callback(reader.close)
        world = _world(config, loaded, store)
        ending.callback(world.close)
        desk = Desk(
            world,
            Meter(clock.now_ns()),
            clock.now_ns,
            ReadElsewhere(reader, store),
            store,
            loaded.model.name,
            config.real_time_factor or 0.0,
            config.seed,
            lockstep=Lockstep(config.lockstep),
        )
        _wait_for_reader(reader, clock, should_stop)
        loop = Loop(desk, BusInbox(bus, config.world), BusOutlet(bus, config.world), clock)
        ending.callback(bus.token(keys.alive_server(config.world)).close)
        LOG.info("serving world=%s endpoint=%s", config.world, bus.endpoint)
        on_ready(bus, config)
        loop.run(should_stop)


def _wait_for_reader(reader: Reader, clock: WallClock, should_stop: Callable[[], bool]) -> None:
    """Serve only once descriptions can be read, so that no spawn pays for the reader's start."""
    give_up_ns = clock.now_ns() + round(READER_START_S * NANOSECONDS)
    while not (reader.is_ready or should_stop() or clock.now_ns() > give_up_ns):
        reader.poll()
        clock.sleep(READER_POLL_S)


def _world(config: ServerConfig, loaded: LoadedWorld, store: AssetStore) -> World:
    world_model = loaded.model
    for name, data in loaded.meshes.items():
        store.pin(name, data)
    engine = PyBulletEngine(
        EngineConfig(
            config.step_ns,
            world_model.gravity,
            world_model.ground_plane,
            world_model.ground_friction,
            mesh_folder=store.folder,
        )
    )
    world = World(
        engine, name=config.world, step_ns=config.step_ns, control_steps=config.control_steps
    )
    furnish(world, world_model)
    if config.is_paused:
        world.pause()
    return world
