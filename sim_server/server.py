"""Composition root: connect the bus, the world, the journal and the loop of one server process."""

from __future__ import annotations

import gc
import logging
import time
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy.ma  # noqa: F401  # else the first np.unique in the loop imports it: 60 ms

from zensim.proto import keys
from zensim.proto.bus import Bus, NoServer, open_bus_with_retry
from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.messages.telemetry_messages import InfoRequest
from zensim.proto.service_catalog import INFO
from zensim.sim_server.journal.server_journal import Journal, open_journal
from zensim.sim_server.journal.sqlite_store import JournalError
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.description_cache import DescriptionCache
from zensim.sim_server.parser_process.parser_client import ParserClient
from zensim.sim_server.ros2_node.server_node import start_server_node
from zensim.sim_server.runtime.loop import ServerLoop, request_short_time_slice
from zensim.sim_server.runtime.loop_channels import BusInbox, BusWorldPublisher
from zensim.sim_server.server_config import (
    ServerConfig,
    WorldAlreadyServed,
    fill_pace,
    validate_config,
)
from zensim.sim_server.service_parts import (
    CurrentWorld,
    Descriptions,
    Pacing,
    ServerParts,
    make_server_parts,
)
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world_loading.world_catalog import WorldCatalog, find_start_file
from zensim.sim_server.world_loading.world_loader import (
    LoadedWorld,
    WorldLoaderRequest,
    list_warnings,
    load_world_in_process,
    make_world_engine,
    make_world_factory,
    spawn_models,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from zensim.sim_server.journal.journal_contents import JournalContents

LOG = logging.getLogger(__name__)
STEP_HZ_TOLERANCE = 1e-6


def load_initial_world(
    config: ServerConfig, journal: Journal | None
) -> tuple[LoadedWorld, ServerConfig]:
    """Load the initial world, or take it from the journal; complete the configuration.

    Raises:
        ConfigError: The world does not exist or cannot be parsed.
        JournalError: The journal belongs to another world.
    """
    if journal is not None and journal.contents is not None:
        return LoadedWorld(journal.contents.world.source), _resume_config(config, journal.contents)
    order = WorldLoaderRequest(
        config.world_file,
        config.model_paths,
        is_strict=config.is_strict,
        allow_missing=config.allow_missing,
    )
    loaded = load_world_in_process(order)
    for fault in list_warnings(loaded.model.report):
        LOG.warning("world=%s %s", config.world_file, fault)
    physics = loaded.model.physics
    return loaded, fill_pace(
        config, step_s=physics.step_s, real_time_factor=physics.real_time_factor
    )


def _resume_config(config: ServerConfig, contents: JournalContents) -> ServerConfig:
    world, factor = contents.world, config.real_time_factor
    if config.world != world.name:
        raise JournalError(
            f"{config.journal} is the journal of world '{world.name}'; "
            f"use --world-name {world.name}, or another folder"
        )
    if (
        config.step_hz is not None
        and abs(config.step_hz - world.step_hz) > STEP_HZ_TOLERANCE * world.step_hz
    ):
        raise JournalError(
            f"{config.journal} counts steps of {world.step_hz:g} Hz, not {config.step_hz:g}; "
            "leave --step-hz out, or use another folder"
        )
    return msgspec.structs.replace(
        config,
        step_hz=world.step_hz,
        real_time_factor=contents.clock.real_time_factor if factor is None else factor,
        seed=world.seed,
    )


INFO_TIMEOUT_S = 2.0
PARSER_START_TIMEOUT_S, PARSER_POLL_S = 30.0, 0.005


class HostClock:
    """Monotonic clock of the host."""

    def now_ns(self) -> int:
        """See `LoopClock`."""
        return time.monotonic_ns()

    def used_ns(self) -> int:
        """See `LoopClock`."""
        return time.thread_time_ns()

    def sleep(self, seconds: float) -> None:
        """See `LoopClock`."""
        time.sleep(seconds)


def run_server(
    config: ServerConfig,
    should_stop: Callable[[], bool],
    on_ready: Callable[[Bus, ServerConfig], None],
) -> None:
    """Run a server until `should_stop` returns True.

    Raises:
        ConfigError: The configuration is not valid.
        WorldAlreadyServed: Another server has this world.
        BusError: The network is not available.
        JournalError: The journal cannot be used.
    """
    config = msgspec.structs.replace(validate_config(config), requested=config)
    with ExitStack() as cleanup:
        journal = open_journal(config.journal) if config.journal else None
        if journal is not None:
            cleanup.callback(journal.close)
        loaded, config = load_initial_world(config, journal)
        if journal is not None:
            journal.exclude_crashing(
                partial(make_world_engine, config, loaded.model, str(journal.files))
            )
        bus = cleanup.enter_context(open_bus_with_retry(config.bus, config.wait_s))
        if _has_server(bus, config.world):
            raise WorldAlreadyServed(
                f"world '{config.world}' already has a server at {bus.endpoint}; "
                "stop it, or use --world-name with another"
            )
        _freeze_garbage_collector()
        request_short_time_slice()
        _run(config, loaded, journal, bus, should_stop, on_ready)


def _has_server(bus: Bus, world: str) -> bool:
    """Whether another server serves the world; our own new router has no other server."""
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
    with ExitStack() as cleanup:
        store = AssetStore()
        cleanup.callback(store.close)
        parser = ParserClient(store, clock.now_ns)
        cleanup.callback(parser.close)
        world = make_initial_world(config, loaded, store, journal)
        cleanup.callback(world.close)
        parts = _make_parts(config, loaded, world, parser, store)
        tracker = None if journal is None else journal.record(parts)
        if tracker is not None:
            cleanup.callback(tracker.close)
        if journal is None or journal.contents is None:
            _wait_for_parser(parser, clock, should_stop)
        node = start_server_node(bus, config.ros)
        cleanup.callback(node.close)
        inbox = BusInbox(bus, config.world, node.sources)
        publisher = BusWorldPublisher(bus, config.world, node.topics, node.on_progress)
        loop = ServerLoop(parts, inbox, publisher, clock, tracker)
        cleanup.callback(bus.token(keys.alive_server(config.world)).close)
        LOG.info("serving world=%s endpoint=%s", config.world, bus.endpoint)
        on_ready(bus, config)
        loop.run(should_stop)


def _make_parts(
    config: ServerConfig,
    loaded: LoadedWorld,
    world: SimulatedWorld,
    parser: ParserClient,
    store: AssetStore,
) -> ServerParts:
    now_ns = HostClock().now_ns
    catalog = WorldCatalog([*map(Path, config.model_paths)], find_start_file(config.world_file))
    resource = catalog.find_start_world(config.world_file, loaded.model.name)
    return make_server_parts(
        world,
        CurrentWorld(loaded.model, resource, config.seed),
        Pacing(
            now_ns,
            LoopStats(now_ns()),
            config.real_time_factor or 0.0,
            lockstep=Lockstep(config.lockstep),
        ),
        Descriptions(DescriptionCache(parser, store, world.prepare, now_ns), store),
        catalog=catalog,
        factory=make_world_factory(config, partial(make_world_engine, mesh_folder=store.folder)),
    )


def _freeze_garbage_collector() -> None:
    """Exclude present objects from garbage collection, which would delay steps."""
    gc.collect()
    gc.freeze()


def _wait_for_parser(
    parser: ParserClient, clock: HostClock, should_stop: Callable[[], bool]
) -> None:
    """Wait until the parser process is ready, so that the first spawn does not wait for it."""
    timeout_ns = clock.now_ns() + round(PARSER_START_TIMEOUT_S * NANOSECONDS)
    while not (parser.is_ready or should_stop() or clock.now_ns() > timeout_ns):
        parser.poll()
        clock.sleep(PARSER_POLL_S)


def make_initial_world(
    config: ServerConfig, loaded: LoadedWorld, store: AssetStore, journal: Journal | None = None
) -> SimulatedWorld:
    """Make the world of a new server, or restore that of its journal."""
    for name, data in loaded.meshes.items():
        store.pin(name, data)
    engine = make_world_engine(config, loaded.model, store.folder)
    world = SimulatedWorld(
        engine, name=config.world, step_ns=config.step_ns, control_steps=config.control_steps
    )
    if journal is not None and journal.contents is not None:
        journal.restore(world, store, time.monotonic_ns())
    else:
        spawn_models(world, loaded.model)
    if config.is_paused:
        world.clock.pause()
    return world
