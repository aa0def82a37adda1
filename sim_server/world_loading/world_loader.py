"""Loads the initial world in a separate process, and builds worlds in an engine model by model."""

from __future__ import annotations

import logging
import time
from itertools import islice
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.child_process import make_module_command, run_process
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.settings.start_settings import WorldFileSettings
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.strict_parsing import quote_names
from zensim.sim_server.description.world_model import WorldModel
from zensim.sim_server.errors import RequestRefused, SimError
from zensim.sim_server.physics.engine import MAX_PENETRATION_RECOVERY_MPS, can_move
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.engine_factory import create_world_engine
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.server_config import ConfigError, fill_pace
from zensim.sim_server.world.simulated_world import BuiltWorld, SimulatedWorld, WorldFactory
from zensim.sim_server.world.spawn_request import ValidatedSpawn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator

    from zensim.proto.messages.model_messages import ReportEntry
    from zensim.proto.settings.engine_settings import EngineSettings
    from zensim.sim_server.physics.engine import Engine
    from zensim.sim_server.server_config import ServerConfig

LOG = logging.getLogger(__name__)
PREPARE_POLL_S = 2e-3
MAX_CHECKED_MODELS = 500
"""Models that move and are checked for overlaps at load: a check takes about 0.1 ms."""
MAX_NAMED_OVERLAPS = 10
COMMAND = make_module_command("zensim.sim_server.world_loading.world_loader_process")


class LoadedWorld(msgspec.Struct, frozen=True):
    """A world and the meshes of its models by sha256."""

    model: WorldModel
    meshes: dict[str, bytes] = {}


class WorldLoaderRequest(msgspec.Struct, frozen=True):
    """The name of a built-in world or a world file, and the folders of its models and meshes."""

    name: str
    files: WorldFileSettings = WorldFileSettings()


class WorldLoaderResult(msgspec.Struct, frozen=True):
    """The world, or the error."""

    loaded: LoadedWorld | None = None
    fault: str = ""


def load_world_in_process(request: WorldLoaderRequest) -> LoadedWorld:
    """Load a world in a child process: parsers of files and meshes need much memory.

    Raises:
        ConfigError: There is no such world, or it cannot be parsed.
    """
    if request.name in list_builtin_worlds():
        # Imported here: a server that restores its journal reads no world.
        from zensim.sim_server.description.sdf.sdf_world import read_world

        return LoadedWorld(read_world(read_builtin_world(request.name)))
    outcome = run_process(COMMAND, msgspec.msgpack.encode(request))
    if outcome.status:
        raise ConfigError(
            f"world '{request.name}' crashed the process that loaded it (status {outcome.status}); "
            "make it simpler"
        )
    result = msgspec.msgpack.decode(outcome.output, type=WorldLoaderResult)
    if result.loaded is None:
        raise ConfigError(result.fault)
    return result.loaded


def list_warnings(report: Iterable[ReportEntry]) -> list[str]:
    """List the suspicious entries of a report."""
    return [f"{entry.subject}: {entry.reason}" for entry in report if entry.status == "suspicious"]


def spawn_models(world: SimulatedWorld, model: WorldModel) -> None:
    """Spawn the models of a world file; raises as `spawn_models_stepwise` does."""
    for is_waiting in spawn_models_stepwise(world, model):
        if is_waiting:
            time.sleep(PREPARE_POLL_S)


def spawn_models_stepwise(world: SimulatedWorld, model: WorldModel) -> Iterator[bool]:
    """Spawn the models of a world file, a part of one in each step.

    Yields:
        Whether the engine still prepares a model, in threads of its own.

    Raises:
        ConfigError: The engine refuses one.
    """
    world.expect(
        [placed.model for placed in model.models],
        [placed.origin.position[:2] for placed in model.models],
    )
    for placed in model.models:
        while not world.prepare(placed.model):
            yield True
        base = np.zeros(13)
        base[:3], base[3:7] = placed.origin.position, placed.origin.orientation
        try:
            world.spawn(ValidatedSpawn(placed.name, "", placed.model, base, belongs_to_world=True))
        except SimError as error:
            raise ConfigError(f"model '{placed.name}' of the world: {error}") from error
        yield False
    world.expect(())
    yield from _warn_of_overlaps(world)


def _warn_of_overlaps(world: SimulatedWorld) -> Iterator[bool]:
    """Name the models that overlap others, in events and a line of the log."""
    overlaps = []
    for one, others in find_model_overlaps(world):
        if others:
            overlaps.append(f"{one!r} and {quote_names(others)}")
            world.clock.warn(one, f"overlaps {quote_names(others)} in the world file")
        yield False
    if overlaps:
        more = f" and {len(overlaps) - MAX_NAMED_OVERLAPS} more"
        LOG.warning(
            "world=%s models overlap and part at %g m/s: %s%s",
            world.name,
            MAX_PENETRATION_RECOVERY_MPS,
            "; ".join(overlaps[:MAX_NAMED_OVERLAPS]),
            more if len(overlaps) > MAX_NAMED_OVERLAPS else "",
        )


def find_model_overlaps(world: SimulatedWorld) -> Iterator[tuple[str, list[str]]]:
    """List each of the first models that move, and those that it overlaps; each pair once."""
    moving = (entity for entity in world.entities if can_move(entity.model))
    seen: set[str] = set()
    for entity in islice(moving, MAX_CHECKED_MODELS):
        found = [other for other in world.find_overlaps(entity) if other not in seen]
        seen.add(entity.name)
        yield entity.name, found


def make_world_engine(config: ServerConfig, model: WorldModel, mesh_folder: str) -> Engine:
    """Create the engine of a world; its meshes are in a folder."""
    engine_config = EngineConfig(
        config.step_ns,
        model.gravity,
        model.ground_plane,
        model.ground_friction,
        mesh_folder=mesh_folder,
        compiles_ahead=config.settings.physics.compiles_ahead,
    )
    return make_layered_engine(
        engine_config, config.settings.physics, control_steps=config.control_steps
    )


def make_layered_engine(
    config: EngineConfig, options: EngineSettings, *, control_steps: int
) -> Engine:
    """Create an engine with all its layers."""
    full = create_world_engine(config, options, period_steps=control_steps)
    return TieredEngine(full, config, options.dynamics, control_steps)


def make_world_factory(
    config: ServerConfig, make_engine: Callable[[ServerConfig, WorldModel], Engine]
) -> WorldFactory:
    """Make a factory of worlds; a world file chooses what the command line does not."""
    requested = config.requested or config

    def build(model: WorldModel) -> Iterator[BuiltWorld | None]:
        physics = model.physics
        world_config = fill_pace(
            requested, step_s=physics.step_s, real_time_factor=physics.real_time_factor
        )
        world = SimulatedWorld(
            make_engine(world_config, model),
            name=world_config.world_name,
            step_ns=world_config.step_ns,
            control_steps=world_config.control_steps,
        )
        is_complete = False
        try:
            for _ in spawn_models_stepwise(world, model):
                yield None
            is_complete = True
        except ConfigError as error:
            raise RequestRefused(ResultCode.OPERATION_FAILED, str(error)) from error
        finally:
            if not is_complete:
                world.close()
        yield BuiltWorld(world, world_config.settings.pace.rtf or 0.0)

    return build
