"""Loads the initial world in a separate process, and builds worlds in an engine model by model."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.proto.child_process import make_module_command, run_process
from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.sdf.sdf_world import WorldModel, read_world
from zensim.sim_server.errors import RequestRefused, SimError
from zensim.sim_server.server_config import ConfigError, fill_pace
from zensim.sim_server.world.simulated_world import World
from zensim.sim_server.world.spawn_request import ValidatedSpawn

if TYPE_CHECKING:
    from zensim.proto.messages.model_messages import ReportEntry
    from zensim.sim_server.physics.engine import Engine
    from zensim.sim_server.server_config import ServerConfig


@dataclass(frozen=True)
class BuiltWorld:
    """A world that is ready to take the place of another, and how fast it is to go."""

    world: World
    real_time_factor: float


WorldFactory = Callable[[WorldModel], Iterator[BuiltWorld | None]]
"""Makes an engine and puts a world's models into it, a part at a time; the world comes last.

Raises SimError. Who does not go on to the end closes it.
"""


COMMAND = make_module_command("zensim.sim_server.world_loading.world_loader_process")


class LoadedWorld(msgspec.Struct, frozen=True):
    """A world, and the meshes that its models name, by sha256."""

    model: WorldModel
    meshes: dict[str, bytes] = {}


class WorldLoaderRequest(msgspec.Struct, frozen=True):
    """What is to be read: a shipped world or a file, and where the files that it names may be."""

    name: str
    model_paths: tuple[str, ...] = ()
    is_strict: bool = False


class WorldLoaderResult(msgspec.Struct, frozen=True):
    """The world, or why there is none."""

    loaded: LoadedWorld | None = None
    fault: str = ""


def load_world_in_process(order: WorldLoaderRequest) -> LoadedWorld:
    """Have a world read by a process of its own: parsers of files and meshes are large.

    Raises:
        ConfigError: There is none, or it cannot be read.
    """
    if order.name in list_builtin_worlds():
        return LoadedWorld(read_world(read_builtin_world(order.name)))
    outcome = run_process(COMMAND, msgspec.msgpack.encode(order))
    if outcome.status:
        raise ConfigError(
            f"world '{order.name}' ended the process that read it (status {outcome.status}); "
            "make it simpler"
        )
    result = msgspec.msgpack.decode(outcome.output, type=WorldLoaderResult)
    if result.loaded is None:
        raise ConfigError(result.fault)
    return result.loaded


def list_warnings(report: Iterable[ReportEntry]) -> list[str]:
    """List what is suspicious."""
    return [f"{entry.subject}: {entry.reason}" for entry in report if entry.status == "suspicious"]


def spawn_models(world: World, model: WorldModel) -> None:
    """Put the models of a world file where they stand; raises as `furnishing` does."""
    for _ in spawn_models_stepwise(world, model):
        pass


def spawn_models_stepwise(world: World, model: WorldModel) -> Iterator[None]:
    """Put the models of a world file where they stand, a part of one at a time.

    Raises:
        ConfigError: The engine cannot simulate one.
    """
    for placed in model.models:
        while not world.prepare(placed.model):
            yield
        base = np.zeros(13)
        base[:3], base[3:7] = placed.origin.position, placed.origin.orientation
        try:
            world.spawn(ValidatedSpawn(placed.name, "", placed.model, base, belongs_to_world=True))
        except SimError as error:
            raise ConfigError(f"model '{placed.name}' of the world: {error}") from error
        yield


def make_world_factory(
    config: ServerConfig, make_engine: Callable[[ServerConfig, WorldModel], Engine]
) -> WorldFactory:
    """Make worlds as this server makes them: what its start did not fix, each world chooses."""
    asked = config.asked or config

    def found(model: WorldModel) -> Iterator[BuiltWorld | None]:
        pace = model.pace
        chosen = fill_pace(asked, step_s=pace.step_s, real_time_factor=pace.real_time_factor)
        world = World(
            make_engine(chosen, model),
            name=chosen.world,
            step_ns=chosen.step_ns,
            control_steps=chosen.control_steps,
        )
        is_whole = False
        try:
            yield from spawn_models_stepwise(world, model)
            is_whole = True
        except ConfigError as error:
            raise RequestRefused(ResultCode.OPERATION_FAILED, str(error)) from error
        finally:
            if not is_whole:
                world.close()
        yield BuiltWorld(world, chosen.real_time_factor or 0.0)

    return found
