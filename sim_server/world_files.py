"""The world that a server begins with: found, read, and put into an engine."""

from __future__ import annotations

from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from sim_server.birth import Birth
from sim_server.config import ConfigError
from sim_server.description.describing import describe_world
from sim_server.description.library import shipped_worlds, world_text
from sim_server.description.sdf import WorldModel
from sim_server.errors import SimError
from sim_server.model_path import bytes_in, models_in
from sim_server.world import World

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from proto.model import ReportEntry

SHOWN = 5
"""Entries of the report that a refusal repeats."""


class LoadedWorld(msgspec.Struct, frozen=True):
    """A world, and the meshes that its models name, by sha256."""

    model: WorldModel
    meshes: dict[str, bytes] = {}


def load_world(
    name: str, model_paths: Iterable[str] = (), *, is_strict: bool = False
) -> LoadedWorld:
    """Read a shipped world by name, or a world file by path, and the files that it names.

    Args:
        name: Of the world.
        model_paths: Folders to look for models and meshes in, beside that of the world file.
        is_strict: Refuse a world of which something was left out or is suspicious.

    Raises:
        ConfigError: There is none, or it cannot be read.
    """
    folders = [Path(path) for path in model_paths]
    try:
        if name in shipped_worlds():
            loaded = _loaded(world_text(name), folders)
        else:
            file = Path(name)
            text = file.read_text(encoding="utf-8")
            loaded = _loaded(text, [file.resolve().parent, *folders])
    except SimError as error:
        raise ConfigError(f"world '{name}': {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        shipped = ", ".join(shipped_worlds())
        raise ConfigError(f"world '{name}' is neither a file nor one of {shipped}") from error
    if is_strict and (faults := doubts(loaded.model.report)):
        raise ConfigError(
            f"world '{name}' is refused by --strict: {'; '.join(faults[:SHOWN])}"
            + (f"; and {len(faults) - SHOWN} more" if len(faults) > SHOWN else "")
        )
    return loaded


def _loaded(text: str, folders: Sequence[Path]) -> LoadedWorld:
    read = bytes_in(folders)

    @cache
    def find_mesh(uri: str) -> tuple[str, bytes] | None:
        data = read(uri)
        return None if data is None else (sha256(data).hexdigest(), data)

    described = describe_world(text, resolve=models_in(folders), find_mesh=find_mesh)
    return LoadedWorld(described.world, described.meshes)


def doubts(report: Iterable[ReportEntry]) -> list[str]:
    """List what is suspicious."""
    return [f"{entry.subject}: {entry.reason}" for entry in report if entry.status == "suspicious"]


def furnish(world: World, model: WorldModel) -> None:
    """Put the models of a world file where they stand.

    Raises:
        ConfigError: The engine cannot simulate one.
    """
    for placed in model.models:
        base = np.zeros(13)
        base[:3], base[3:7] = placed.origin.position, placed.origin.orientation
        try:
            world.spawn(Birth(placed.name, "", placed.model, base, belongs_to_world=True))
        except SimError as error:
            raise ConfigError(f"model '{placed.name}' of the world: {error}") from error
