"""The world that a server begins with: found, read, and put into an engine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim_server.config import ConfigError
from sim_server.description.library import shipped_worlds, world_text
from sim_server.description.sdf import WorldModel, read_world
from sim_server.errors import SimError
from sim_server.model_path import models_in
from sim_server.world import Birth, World

if TYPE_CHECKING:
    from collections.abc import Iterable

    from proto.model import ReportEntry

SHOWN = 5
"""Entries of the report that a refusal repeats."""


def load_world(
    name: str, model_paths: Iterable[str] = (), *, is_strict: bool = False
) -> WorldModel:
    """Read a shipped world by name, or a world file by path.

    Args:
        name: Of the world.
        model_paths: Folders to look for included models in, beside that of the world file.
        is_strict: Refuse a world of which something was left out or is suspicious.

    Raises:
        ConfigError: There is none, or it cannot be read.
    """
    folders = [Path(path) for path in model_paths]
    try:
        if name in shipped_worlds():
            world = read_world(world_text(name), resolve=models_in(folders))
        else:
            file = Path(name)
            text = file.read_text(encoding="utf-8")
            world = read_world(text, resolve=models_in([file.resolve().parent, *folders]))
    except SimError as error:
        raise ConfigError(f"world '{name}': {error}") from error
    except (OSError, UnicodeDecodeError) as error:
        shipped = ", ".join(shipped_worlds())
        raise ConfigError(f"world '{name}' is neither a file nor one of {shipped}") from error
    if is_strict and (faults := doubts(world.report)):
        raise ConfigError(
            f"world '{name}' is refused by --strict: {'; '.join(faults[:SHOWN])}"
            + (f"; and {len(faults) - SHOWN} more" if len(faults) > SHOWN else "")
        )
    return world


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
