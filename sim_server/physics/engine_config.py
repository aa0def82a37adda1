"""Configuration of physics: what a world requires of its engine, and the server's choice of engine, cells and workers."""

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Literal, get_args

import msgspec

from zensim.proto.messages.model_messages import Dynamics

Clustering = Literal["auto", "on", "off"]
EngineName = Literal["pybullet", "mujoco"]

INSTALL_COMMANDS: dict[EngineName, str] = {
    "pybullet": "pip install 'zensim[server]' (Linux x86_64, Python 3.10 or 3.11)",
    "mujoco": "pip install 'zensim[server,mujoco]'",
}


class EngineMissing(ValueError):
    """The library of an engine is not installed."""


class EngineOptions(msgspec.Struct, frozen=True, kw_only=True):
    """Which engines stand for each world of a server."""

    engine: EngineName | None = None
    """None = the first of pybullet and mujoco whose library is installed."""
    clusters: Clustering = "auto"
    """Whether bodies that cannot touch are stepped apart; auto = when there are enough of them."""
    workers: int | None = None
    """Processes beside the server's that step cells; None = as many as there are further cores,
    for an engine that keeps Python from running meanwhile."""
    dynamics: Dynamics = "full"
    """Of entities that do not ask for any."""


def parse_engine_name(name: str) -> EngineName | None:
    """Read the name of an engine; nothing leaves the choice open.

    Raises:
        ValueError: There is no such engine.
    """
    for known in get_args(EngineName):
        if name == known:
            return known  # type: ignore[no-any-return]
    if name:
        raise ValueError(f"--engine {name!r} is unknown; use {' or '.join(INSTALL_COMMANDS)}")
    return None


def find_installed_engines() -> list[EngineName]:
    """List the engines whose library is installed, the preferred first."""
    return [name for name in INSTALL_COMMANDS if find_spec(name) is not None]


def choose_engine(choice: EngineOptions, here: Sequence[EngineName]) -> EngineName:
    """Find the engine of a choice among those that are here.

    Raises:
        EngineMissing: Its library is not installed, or none is.
    """
    if (found := choice.engine or next(iter(here), None)) is not None and found in here:
        return found
    missing = choice.engine or "pybullet"
    others = [f"use --engine {name}, which is" for name in here]
    others += [f"{how} for {name}" for name, how in INSTALL_COMMANDS.items() if name not in here]
    raise EngineMissing(f"{missing} is not installed; {', or '.join(others)}")


@dataclass(frozen=True)
class EngineConfig:
    """What a world asks of its physics."""

    step_ns: int
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)
    has_ground: bool = True
    ground_friction: float = 1.0
    mesh_folder: str = ""
    """Where `<Shape.mesh>.stl` is."""
