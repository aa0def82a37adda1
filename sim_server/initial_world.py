"""The parts of a server but its network: the initial world, and what its services act on."""

from __future__ import annotations

import logging
import time
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec

from zensim.proto.settings.setting import change_settings
from zensim.sim_server.journal.sqlite_store import JournalError
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.parser_process.description_cache import DescriptionCache
from zensim.sim_server.physics.logged_engine import LoggedEngine
from zensim.sim_server.server_config import ConfigError, fill_pace, resume_pace
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

    from zensim.sim_server.description.world_model import WorldModel
    from zensim.sim_server.journal.journal_contents import JournalContents
    from zensim.sim_server.journal.server_journal import Journal
    from zensim.sim_server.parser_process.asset_store import AssetStore
    from zensim.sim_server.parser_process.description_cache import Parser
    from zensim.sim_server.physics.engine import Engine
    from zensim.sim_server.server_config import ServerConfig

LOG = logging.getLogger(__name__)


def make_logged_engine(config: ServerConfig, model: WorldModel, mesh_folder: str) -> Engine:
    """Create the engine of a world, and note what changes it; see `make_world_engine`."""
    return LoggedEngine(make_world_engine(config, model, mesh_folder))


def load_initial_world(
    config: ServerConfig,
    journal: Journal | None,
    load: Callable[[WorldLoaderRequest], LoadedWorld] = load_world_in_process,
) -> tuple[LoadedWorld, ServerConfig]:
    """Load the initial world, or take it from the journal; complete the configuration.

    Args:
        config: As requested, and valid.
        journal: Of the server, if it has one.
        load: Loads the world.

    Raises:
        ConfigError: The world does not exist or cannot be parsed.
        JournalError: The journal belongs to another world.
    """
    if journal is not None and journal.contents is not None:
        return LoadedWorld(journal.contents.world.source), _resume_config(config, journal.contents)
    start = config.settings.start
    order = WorldLoaderRequest(start.world, start)
    loaded = load(order)
    for fault in list_warnings(loaded.model.report):
        LOG.warning("world=%s %s", start.world, fault)
    physics = loaded.model.physics
    return loaded, fill_pace(
        config, step_s=physics.step_s, real_time_factor=physics.real_time_factor
    )


def _resume_config(config: ServerConfig, contents: JournalContents) -> ServerConfig:
    world = contents.world
    if config.world_name != world.name:
        raise JournalError(
            f"{config.journal} is the journal of world '{world.name}'; "
            f"use `world_name` {world.name}, or another folder"
        )
    try:
        resumed = resume_pace(
            config, hz=world.step_rate_hz, real_time_factor=contents.clock.real_time_factor
        )
    except ConfigError as error:
        raise JournalError(f"{config.journal} {error}, or use another folder") from error
    settings = change_settings(resumed.settings, {"seed": world.seed})
    return msgspec.structs.replace(resumed, settings=settings)


def make_initial_world(
    config: ServerConfig, loaded: LoadedWorld, store: AssetStore, journal: Journal | None = None
) -> SimulatedWorld:
    """Make the world of a new server, or restore that of its journal."""
    for name, data in loaded.meshes.items():
        store.pin(name, data)
    make_engine = make_logged_engine if config.keeps_inputs else make_world_engine
    engine = make_engine(config, loaded.model, store.folder)
    world = SimulatedWorld(
        engine, name=config.world_name, step_ns=config.step_ns, control_steps=config.control_steps
    )
    if journal is not None and journal.contents is not None:
        journal.restore(world, store, time.monotonic_ns())
    else:
        spawn_models(world, loaded.model)
    if config.settings.start.paused:
        world.clock.pause()
    return world


def make_parts(
    config: ServerConfig,
    loaded: LoadedWorld,
    world: SimulatedWorld,
    parser: Parser,
    *,
    store: AssetStore,
    now_ns: Callable[[], int],
) -> ServerParts:
    """Make the parts of a server around its world.

    Args:
        config: As completed by `load_initial_world`.
        loaded: The initial world.
        world: Made by `make_initial_world`.
        parser: Parses descriptions and world files.
        store: Of the parser and the engine.
        now_ns: Wall time.
    """
    # A log of inputs begins with the first call of an engine, long before its world is used.
    make_engine = make_world_engine if config.bus is None else make_logged_engine
    start = config.settings.start
    catalog = WorldCatalog([*map(Path, start.model_paths)], find_start_file(start.world))
    resource = catalog.find_start_world(start.world, loaded.model.name)
    return make_server_parts(
        world,
        CurrentWorld(loaded.model, resource, start.seed, config.settings.physics),
        Pacing(
            now_ns,
            LoopStats(now_ns()),
            config.settings.pace.rtf or 0.0,
            lockstep=Lockstep(config.settings.lockstep),
        ),
        Descriptions(DescriptionCache(parser, store, world.prepare, now_ns), store),
        catalog=catalog,
        factory=make_world_factory(config, partial(make_engine, mesh_folder=store.folder)),
    )
