"""What a server begins with: a world that is read, or the one that its journal holds."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import msgspec

from zensim.sim_server.journal.ledger import JournalError
from zensim.sim_server.loading.world_files import LoadedWorld, WorldOrder, doubts, loaded_elsewhere
from zensim.sim_server.server_config import fill_pace

if TYPE_CHECKING:
    from zensim.sim_server.journal.opening import Journal
    from zensim.sim_server.journal.restoring import Contents
    from zensim.sim_server.server_config import ServerConfig

LOG = logging.getLogger(__name__)
SAME_HZ = 1e-6


def begin(config: ServerConfig, journal: Journal | None) -> tuple[LoadedWorld, ServerConfig]:
    """Find the world to begin with, and fill in what was not asked for.

    Raises:
        ConfigError: There is no such world, or it cannot be read.
        JournalError: The journal is of another world than was asked for.
    """
    if journal is not None and journal.contents is not None:
        return LoadedWorld(journal.contents.world.source), _resumed(config, journal.contents)
    order = WorldOrder(config.world_file, config.model_paths, config.is_strict)
    loaded = loaded_elsewhere(order)
    for fault in doubts(loaded.model.report):
        LOG.warning("world=%s %s", config.world_file, fault)
    pace = loaded.model.pace
    return loaded, fill_pace(config, step_s=pace.step_s, real_time_factor=pace.real_time_factor)


def _resumed(config: ServerConfig, contents: Contents) -> ServerConfig:
    world, factor = contents.world, config.real_time_factor
    if config.world != world.name:
        raise JournalError(
            f"{config.journal} is the journal of world '{world.name}'; "
            f"use --world-name {world.name}, or another folder"
        )
    if config.step_hz is not None and abs(config.step_hz - world.step_hz) > SAME_HZ * world.step_hz:
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
