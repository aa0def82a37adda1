"""Models and worlds shipped with the server; a spawn resource to its text."""

from importlib.resources import files

from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.messages.spawn_messages import Resource
from zensim.sim_server.errors import ModelError

MODEL_FILES = ("models", ".urdf")
WORLD_FILES = ("worlds", ".sdf")


def list_builtin_models() -> tuple[str, ...]:
    """Name the robots that come with the server."""
    return _list_names(*MODEL_FILES)


def list_builtin_worlds() -> tuple[str, ...]:
    """Name the worlds that come with the server."""
    return _list_names(*WORLD_FILES)


def read_builtin_model(name: str) -> str:
    """Read the URDF of a robot that comes with the server.

    Raises:
        ModelError: None has this name.
    """
    return _read_file(name, "model", *MODEL_FILES)


def read_builtin_world(name: str) -> str:
    """Read the SDF of a world that comes with the server.

    Raises:
        ModelError: None has this name.
    """
    return _read_file(name, "world", *WORLD_FILES)


def _list_names(folder: str, suffix: str) -> tuple[str, ...]:
    entries = files("zensim.sim_server").joinpath(folder).iterdir()
    return tuple(
        sorted(entry.name.removesuffix(suffix) for entry in entries if entry.name.endswith(suffix))
    )


def _read_file(name: str, what: str, folder: str, suffix: str) -> str:
    # Only names that were listed are joined to a path.
    names = _list_names(folder, suffix)
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


BUILTIN_SCHEMES = ("model://", "zensim://")


def resolve_resource(resource: Resource) -> str:
    """Find the text of a description.

    A uri names a model shipped with the server; no file is opened because a request names it.

    Raises:
        ModelError: There is none.
    """
    if resource.resource_string:
        return resource.resource_string
    if not resource.uri:
        raise ModelError(
            "entity_resource is empty; give a uri of a shipped model or a resource_string",
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
            f"uri {uri[:120]!r} is not a shipped model; send the text as resource_string",
            code=ResultCode.NOT_FOUND,
            slug="resource.unknown",
        )
    return uri
