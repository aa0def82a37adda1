"""Engines that are installed, the choice of one, and the physics of a world."""

import platform
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import get_args

from zensim.proto.engine_proofs import EngineName
from zensim.proto.settings.engine_settings import EngineChoice

INSTALL_COMMAND = "pip install 'zensim[server]'"
"""Command that installs each engine that has a wheel for this Python and system."""
PYBULLET_SYSTEMS = (("linux", "x86_64"), ("darwin", "arm64"), ("win32", "AMD64"))
"""Systems and machines for which PyBullet, or its fork, has wheels."""
PYBULLET_BELOW = (3, 14)
"""First Python without a wheel of PyBullet, as pyproject.toml says, too."""


class EngineUnusable(ValueError):
    """No world can be made with the chosen engine."""


class EngineMissing(EngineUnusable):
    """The library of an engine is not installed."""

    slug = "engine.missing"


def parse_engine_name(name: str) -> EngineName | None:
    """Parse the name of an engine; an empty string is None.

    Raises:
        ValueError: The name is unknown.
    """
    for known in get_args(EngineName):
        if name == known:
            return known  # type: ignore[no-any-return]
    if name:
        raise ValueError(f"`engine` {name!r} is unknown; use {' or '.join(get_args(EngineName))}")
    return None


def find_installed_engines() -> list[EngineName]:
    """List the engines whose library is installed, in order of preference."""
    return [name for name in get_args(EngineName) if find_spec(name) is not None]


def has_wheel(name: EngineName) -> bool:
    """Whether this Python and system can install an engine without a compiler."""
    if name != "pybullet":
        return True
    return (
        sys.version_info < PYBULLET_BELOW and (sys.platform, platform.machine()) in PYBULLET_SYSTEMS
    )


def explain_missing(name: EngineName) -> str:
    """Say why an engine is not installed, and what to do about it, in a clause."""
    if has_wheel(name):
        return f"{INSTALL_COMMAND} installs {name}"
    python = ".".join(platform.python_version_tuple()[:2])
    return f"{name} has no wheel for Python {python} on {sys.platform} {platform.machine()}"


def explain_default(choice: EngineChoice, installed: Sequence[EngineName]) -> str | None:
    """Say why the default engine is not the first one; None if it is, or an engine was chosen."""
    first = get_args(EngineName)[0]
    if choice.engine is not None or not installed or first in installed:
        return None
    return f"{first} is not installed: {installed[0]} is the engine; {explain_missing(first)}"


def choose_engine(choice: EngineChoice, installed: Sequence[EngineName]) -> EngineName:
    """Choose an installed engine.

    Raises:
        EngineMissing: The chosen one is not installed, or none is.
    """
    found = choice.engine or next(iter(installed), None)
    if found is not None and found in installed:
        return found
    missing = choice.engine or ("pybullet" if has_wheel("pybullet") else "mujoco")
    others = [f"use `engine` {name}, which is installed" for name in installed]
    raise EngineMissing(
        f"{EngineMissing.slug}: {missing} is not installed; "
        f"{', or '.join([*others, explain_missing(missing)])}"
    )


@dataclass(frozen=True)
class EngineConfig:
    """Physics settings of a world."""

    step_ns: int
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    has_ground: bool = True
    ground_friction: float = 1.0
    mesh_folder: str = ""
    """Folder with `<Shape.mesh>.stl` files."""
    compiles_ahead: bool = True
    """See `EngineSettings`."""
