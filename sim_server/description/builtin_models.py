"""Built-in models and worlds, and the text of a spawn resource."""

from functools import cache
from importlib.resources import files

from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.messages.spawn_messages import Resource
from zensim.sim_server.errors import ModelError

MODEL_FILES = ("models", ".urdf")
WORLD_FILES = ("worlds", ".sdf")


def list_builtin_models() -> tuple[str, ...]:
    """List the names of the built-in robots."""
    return _list_names(*MODEL_FILES)


def list_builtin_worlds() -> tuple[str, ...]:
    """List the names of the built-in worlds."""
    return _list_names(*WORLD_FILES)


def read_builtin_model(name: str) -> str:
    """Read the URDF of a built-in robot.

    Raises:
        ModelError: It does not exist.
    """
    return _read_file(name, "model", *MODEL_FILES)


def read_builtin_world(name: str) -> str:
    """Read the SDF of a built-in world.

    Raises:
        ModelError: It does not exist.
    """
    return _read_file(name, "world", *WORLD_FILES)


@cache
def _list_names(folder: str, suffix: str) -> tuple[str, ...]:
    entries = files("zensim.sim_server").joinpath(folder).iterdir()
    return tuple(
        sorted(entry.name.removesuffix(suffix) for entry in entries if entry.name.endswith(suffix))
    )


def _read_file(name: str, what: str, folder: str, suffix: str) -> str:
    # Only listed names become part of a path.
    names = _list_names(folder, suffix)
    if name not in names:
        raise ModelError(
            f"no built-in {what} is named {name[:80]!r}; use one of {', '.join(names)}",
            code=ResultCode.NOT_FOUND,
            slug=f"library.{what}",
        )
    return _read_text(folder, name + suffix)


@cache
def _read_text(folder: str, file: str) -> str:
    return files("zensim.sim_server").joinpath(folder).joinpath(file).read_text(encoding="utf-8")


BUILTIN_SCHEMES = ("model://", "zensim://")


def resolve_resource(resource: Resource) -> str:
    """Find the text of a description; a uri is the name of a built-in model, never a path.

    Raises:
        ModelError: The resource is empty or the model does not exist.
    """
    if resource.resource_string:
        return resource.resource_string
    if not resource.uri:
        raise ModelError(
            "entity_resource is empty; set the uri of a built-in model or a resource_string",
            code=SpawnCode.NO_RESOURCE,
            slug="resource.empty",
        )
    return read_builtin_model(_builtin_name(resource.uri))


def _builtin_name(uri: str) -> str:
    for scheme in BUILTIN_SCHEMES:
        if uri.startswith(scheme):
            return uri.removeprefix(scheme)
    if "://" in uri or "/" in uri or uri.startswith("."):
        raise ModelError(
            f"uri {uri[:120]!r} is not a built-in model; send the text as resource_string",
            code=ResultCode.NOT_FOUND,
            slug="resource.unknown",
        )
    return uri
