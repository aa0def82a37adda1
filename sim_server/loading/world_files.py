"""The world that a server begins with: found, read elsewhere, and put into an engine."""

from __future__ import annotations

import subprocess
import sys
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from zensim.sim_server.description.builtin_models import list_builtin_worlds, read_builtin_world
from zensim.sim_server.description.sdf.sdf_world import WorldModel, read_world
from zensim.sim_server.errors import SimError
from zensim.sim_server.server_config import ConfigError
from zensim.sim_server.world.birth import Birth

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from zensim.proto.messages.model_messages import ReportEntry
    from zensim.sim_server.world.world import World

COMMAND = (sys.executable, "-m", "zensim.sim_server.loading.world_loading")


class LoadedWorld(msgspec.Struct, frozen=True):
    """A world, and the meshes that its models name, by sha256."""

    model: WorldModel
    meshes: dict[str, bytes] = {}


class WorldOrder(msgspec.Struct, frozen=True):
    """What is to be read: a shipped world or a file, and where the files that it names may be."""

    name: str
    model_paths: tuple[str, ...] = ()
    is_strict: bool = False


class WorldOutcome(msgspec.Struct, frozen=True):
    """The world, or why there is none."""

    loaded: LoadedWorld | None = None
    fault: str = ""


def loaded_elsewhere(order: WorldOrder) -> LoadedWorld:
    """Have a world read by a process of its own: parsers of files and meshes are large.

    Raises:
        ConfigError: There is none, or it cannot be read.
    """
    if order.name in list_builtin_worlds():
        return LoadedWorld(read_world(read_builtin_world(order.name)))
    payload = msgspec.msgpack.encode(order)
    done = subprocess.run(COMMAND, input=payload, stdout=subprocess.PIPE, check=False)
    if done.returncode:
        raise ConfigError(
            f"world '{order.name}' ended the process that read it (status {done.returncode}); "
            "make it simpler"
        )
    outcome = msgspec.msgpack.decode(done.stdout, type=WorldOutcome)
    if outcome.loaded is None:
        raise ConfigError(outcome.fault)
    return outcome.loaded


def doubts(report: Iterable[ReportEntry]) -> list[str]:
    """List what is suspicious."""
    return [f"{entry.subject}: {entry.reason}" for entry in report if entry.status == "suspicious"]


def furnish(world: World, model: WorldModel) -> None:
    """Put the models of a world file where they stand; raises as `furnishing` does."""
    for _ in furnishing(world, model):
        pass


def furnishing(world: World, model: WorldModel) -> Iterator[None]:
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
            world.spawn(Birth(placed.name, "", placed.model, base, belongs_to_world=True))
        except SimError as error:
            raise ConfigError(f"model '{placed.name}' of the world: {error}") from error
        yield
