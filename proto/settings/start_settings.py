"""Settings of the start of a world: its file, its random numbers, and whether time runs."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Final, TypedDict

import msgspec

from zensim.proto.settings.path_completion import complete_worlds
from zensim.proto.settings.setting import Setting

MAX_SEED: Final = (1 << 64) - 1


class WorldFileSettings(msgspec.Struct, frozen=True, kw_only=True):
    """How a world file is read."""

    model_paths: Annotated[
        tuple[str, ...],
        Setting(
            help="Folder with models that the world file includes; repeatable.",
            spelling="--model-path",
            metavar="FOLDER",
            variables=("GAZEBO_MODEL_PATH",),
            key="world.model_paths",
        ),
    ] = ()
    strict: Annotated[
        bool, Setting(help="Fail if the world file has warnings.", key="world.strict")
    ] = False
    allow_missing: Annotated[
        bool,
        Setting(
            help="Leave out models and collisions of the world file whose file is missing.",
            key="world.allow_missing",
        ),
    ] = False


USUAL_READING: Final = WorldFileSettings()
"""Reading of a world file by default."""


class StartSettings(WorldFileSettings, frozen=True, kw_only=True):
    """The first world of a server."""

    world: Annotated[
        str,
        Setting(
            help="Built-in world or SDF file to load.",
            metavar="NAME|FILE",
            key="world.load",
            complete=complete_worlds,
        ),
    ] = "empty"
    paused: Annotated[bool, Setting(help="Start paused.", key="time.paused")] = False
    seed: Annotated[
        int,
        Setting(
            help="Seed of random numbers.", metavar="N", least=0, most=MAX_SEED, key="time.seed"
        ),
    ] = 0


class StartKeywords(TypedDict, total=False):
    """The start of a world, as keyword arguments."""

    seed: int
    """Seed of the noise of sensors and of all other random numbers."""
    model_paths: Sequence[str | Path]
    """Folders with the models and meshes that the world file includes."""
    strict: bool
    """Refuse a world file with warnings."""
    allow_missing: bool
    """Leave out models and collisions whose file is missing."""
