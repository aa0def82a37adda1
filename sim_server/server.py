"""Composition root: connect the bus, the world, the journal and the loop of one server process."""

import gc
import logging
import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import msgspec
import numpy.ma  # noqa: F401  # numpy would look for it in the loop, in the first np.unique: 60 ms

from zensim.proto import keys
from zensim.proto.bus import Bus, NoServer, open_bus_with_retry
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.service_catalog import INFO
from zensim.sim_server.description.sdf.sdf_world import WorldModel
from zensim.sim_server.journal.opening import Journal, open_journal
from zensim.sim_server.loading.beginning import begin
from zensim.sim_server.loading.founding import founding
from zensim.sim_server.loading.world_files import LoadedWorld, furnish
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import create_world_engine
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.reading.assets import AssetStore
from zensim.sim_server.reading.descriptions import ReadElsewhere
from zensim.sim_server.reading.reader import Reader
from zensim.sim_server.ros2_node.server_node import start_server_node
from zensim.sim_server.runtime.inbox import BusInbox
from zensim.sim_server.runtime.linux_scheduling import request_short_time_slice
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.runtime.world_publisher import BusWorldPublisher
from zensim.sim_server.server_config import ServerConfig, WorldAlreadyServed, validate_config
from zensim.sim_server.server_context import ServerContext
from zensim.sim_server.world.world import World
from zensim.sim_server.worlds.atlas import Atlas, start_file

INFO_TIMEOUT_S = 2.0
PARSER_START_TIMEOUT_S, PARSER_POLL_S = 30.0, 0.005
LOG = logging.getLogger(__name__)


class HostClock:
    """The host's monotonic clock."""

    def now_ns(self) -> int:
        """See `Clock`."""
        return time.monotonic_ns()

    def used_ns(self) -> int:
        """See `Clock`."""
        return time.thread_time_ns()

    def sleep(self, seconds: float) -> None:
        """See `Clock`."""
        time.sleep(seconds)


def run_server(
    config: ServerConfig,
    should_stop: Callable[[], bool],
    on_ready: Callable[[Bus, ServerConfig], None],
) -> None:
    """Run a server until told to stop.

    Raises:
        ConfigError: The configuration cannot work.
        AlreadyServed: Another server has this world.
        BusError: The network cannot be joined.
        JournalError: The journal cannot be used.
    """
    config = msgspec.structs.replace(validate_config(config), asked=config)
    with ExitStack() as ending:
        journal = open_journal(config.journal) if config.journal else None
        if journal is not None:
            ending.callback(journal.close)
        loaded, config = begin(config, journal)
        if journal is not None:
            journal.leave_out_deadly(
                partial(_make_engine, config, loaded.model, str(journal.files))
            )
        bus = ending.enter_context(open_bus_with_retry(config.bus, config.wait_s))
        if _has_server(bus, config.world):
            raise WorldAlreadyServed(
                f"world '{config.world}' already has a server at {bus.endpoint}; "
                "stop it, or use --world-name with another"
            )
        _freeze_garbage_collector()
        request_short_time_slice()
        _run(config, loaded, journal, bus, should_stop, on_ready)


def _has_server(bus: Bus, world: str) -> bool:
    """Whether another server answers for a world; a router of our own is too young to have one."""
    if bus.config.mode == "router":
        return False
    try:
        bus.call(INFO, InfoRequest(), world=world, timeout_s=INFO_TIMEOUT_S)
    except NoServer:
        return bool(bus.list_tokens(keys.alive_server(world)))
    except TimeoutError:
        return True
    return True


def _run(
    config: ServerConfig,
    loaded: LoadedWorld,
    journal: Journal | None,
    bus: Bus,
    should_stop: Callable[[], bool],
    on_ready: Callable[[Bus, ServerConfig], None],
) -> None:
    clock = HostClock()
    with ExitStack() as ending:
        store = AssetStore()
        ending.callback(store.close)
        reader = Reader(store, clock.now_ns)
        ending.callback(reader.close)
        world = _make_world(config, loaded, store, journal)
        ending.callback(world.close)
        desk = _make_context(config, loaded, world, reader, store)
        if journal is not None:
            ending.callback(journal.record(desk).close)
        if journal is None or journal.contents is None:
            _wait_for_parser(reader, clock, should_stop)
        side = start_server_node(bus, config.ros)
        ending.callback(side.close)
        inbox = BusInbox(bus, config.world, side.sources)
        loop = ServerLoop(
            desk, inbox, BusWorldPublisher(bus, config.world, side.faces, side.on_progress), clock
        )
        ending.callback(bus.token(keys.alive_server(config.world)).close)
        LOG.info("serving world=%s endpoint=%s", config.world, bus.endpoint)
        on_ready(bus, config)
        loop.run(should_stop)


def _make_context(
    config: ServerConfig, loaded: LoadedWorld, world: World, reader: Reader, store: AssetStore
) -> ServerContext:
    now_ns = HostClock().now_ns
    desk = ServerContext(
        world,
        LoopStats(now_ns()),
        now_ns,
        ReadElsewhere(reader, store, world.prepare, now_ns),
        store,
        loaded.model.name,
        config.real_time_factor or 0.0,
        config.seed,
        lockstep=Lockstep(config.lockstep),
    )
    desk.source = loaded.model
    desk.world_catalog = Atlas([*map(Path, config.model_paths)], start_file(config.world_file))
    desk.resource = desk.world_catalog.started(config.world_file, loaded.model.name)
    desk.world_factory = founding(config, partial(_make_engine, mesh_folder=store.folder))
    return desk


def _freeze_garbage_collector() -> None:
    """Let Python's collector pass over what is here by now: it would hold steps up."""
    gc.collect()
    gc.freeze()


def _wait_for_parser(reader: Reader, clock: HostClock, should_stop: Callable[[], bool]) -> None:
    """Serve only once descriptions can be read, so that no spawn pays for the reader's start."""
    give_up_ns = clock.now_ns() + round(PARSER_START_TIMEOUT_S * NANOSECONDS)
    while not (reader.is_ready or should_stop() or clock.now_ns() > give_up_ns):
        reader.poll()
        clock.sleep(PARSER_POLL_S)


def _make_world(
    config: ServerConfig, loaded: LoadedWorld, store: AssetStore, journal: Journal | None
) -> World:
    for name, data in loaded.meshes.items():
        store.pin(name, data)
    engine = _make_engine(config, loaded.model, store.folder)
    world = World(
        engine, name=config.world, step_ns=config.step_ns, control_steps=config.control_steps
    )
    if journal is not None and journal.contents is not None:
        journal.restore(world, store, time.monotonic_ns())
    else:
        furnish(world, loaded.model)
    if config.is_paused:
        world.pause()
    return world


def _make_engine(config: ServerConfig, model: WorldModel, mesh_folder: str) -> Engine:
    asked = EngineConfig(
        config.step_ns,
        model.gravity,
        model.ground_plane,
        model.ground_friction,
        mesh_folder=mesh_folder,
    )
    full = create_world_engine(asked, config.physics, period_steps=config.control_steps)
    return TieredEngine(full, asked, config.physics.dynamics)
