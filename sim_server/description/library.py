"""Robots and worlds that come with the server."""

from importlib.resources import files

from zensim.proto.messages.result_messages import ResultCode
from zensim.sim_server.errors import ModelError

MODELS = ("models", ".urdf")
WORLDS = ("worlds", ".sdf")


def shipped_models() -> tuple[str, ...]:
    """Name the robots that come with the server."""
    return _names(*MODELS)


def shipped_worlds() -> tuple[str, ...]:
    """Name the worlds that come with the server."""
    return _names(*WORLDS)


def model_text(name: str) -> str:
    """Read the URDF of a robot that comes with the server.

    Raises:
        ModelError: None has this name.
    """
    return _text(name, "model", *MODELS)


def world_text(name: str) -> str:
    """Read the SDF of a world that comes with the server.

    Raises:
        ModelError: None has this name.
    """
    return _text(name, "world", *WORLDS)


def _names(folder: str, suffix: str) -> tuple[str, ...]:
    entries = files("zensim.sim_server").joinpath(folder).iterdir()
    return tuple(
        sorted(entry.name.removesuffix(suffix) for entry in entries if entry.name.endswith(suffix))
    )


def _text(name: str, what: str, folder: str, suffix: str) -> str:
    # Only names that were listed are joined to a path.
    names = _names(folder, suffix)
    if name not in names:
        raise ModelError(
            f"no {what} {name[:80]!r} comes with the server; there is {', '.join(names)}",
            code=ResultCode.NOT_FOUND,
            slug=f"library.{what}",
        )
    return (
        files("zensim.sim_server")
        .joinpath(folder)
        .joinpath(name + suffix)
        .read_text(encoding="utf-8")
    )
