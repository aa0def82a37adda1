"""What a server is told of the physics of its worlds."""

from collections.abc import Sequence
from importlib.util import find_spec
from typing import Literal, get_args

import msgspec

from zensim.proto.messages.model_messages import Dynamics

Clustering = Literal["auto", "on", "off"]
EngineName = Literal["pybullet", "mujoco"]

INSTALLED_BY: dict[EngineName, str] = {
    "pybullet": "pip install 'zensim[server]' (Linux x86_64, Python 3.10 or 3.11)",
    "mujoco": "pip install 'zensim[server,mujoco]'",
}


class EngineMissing(ValueError):
    """The library of an engine is not installed."""


class EngineChoice(msgspec.Struct, frozen=True, kw_only=True):
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


def engine_named(name: str) -> EngineName | None:
    """Read the name of an engine; nothing leaves the choice open.

    Raises:
        ValueError: There is no such engine.
    """
    for known in get_args(EngineName):
        if name == known:
            return known  # type: ignore[no-any-return]
    if name:
        raise ValueError(f"--engine {name!r} is unknown; use {' or '.join(INSTALLED_BY)}")
    return None


def engines_here() -> list[EngineName]:
    """List the engines whose library is installed, the preferred first."""
    return [name for name in INSTALLED_BY if find_spec(name) is not None]


def engine_of(choice: EngineChoice, here: Sequence[EngineName]) -> EngineName:
    """Find the engine of a choice among those that are here.

    Raises:
        EngineMissing: Its library is not installed, or none is.
    """
    if (found := choice.engine or next(iter(here), None)) is not None and found in here:
        return found
    missing = choice.engine or "pybullet"
    others = [f"use --engine {name}, which is" for name in here]
    others += [f"{how} for {name}" for name, how in INSTALLED_BY.items() if name not in here]
    raise EngineMissing(f"{missing} is not installed; {', or '.join(others)}")
