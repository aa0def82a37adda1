"""A spawn request's resource to a Model; equal texts are read once."""

from functools import lru_cache

from proto.model import Model
from proto.result import ResultCode, SpawnCode
from proto.services import Resource
from sim_server.description.library import model_text
from sim_server.description.urdf import read_urdf
from sim_server.errors import ModelError

SCHEMES = ("model://", "zensim://")


def read_resource(resource: Resource) -> tuple[Model, str]:
    """Read a description and return it with its text.

    A uri names a model shipped with the server; no file is opened because a request names it.

    Raises:
        ModelError: There is none, both are given, or it cannot be read.
    """
    if resource.resource_string:
        return _read(resource.resource_string), resource.resource_string
    if not resource.uri:
        raise ModelError(
            "entity_resource is empty; give a uri of a shipped model or a resource_string",
            code=SpawnCode.NO_RESOURCE,
            slug="resource.empty",
        )
    text = model_text(_shipped_name(resource.uri))
    return _read(text), text


def _shipped_name(uri: str) -> str:
    for scheme in SCHEMES:
        if uri.startswith(scheme):
            return uri.removeprefix(scheme)
    if "://" in uri or "/" in uri or uri.startswith("."):
        raise ModelError(
            f"uri {uri[:120]!r} is not a shipped model; send the text as resource_string",
            code=ResultCode.NOT_FOUND,
            slug="resource.unknown",
        )
    return uri


@lru_cache(maxsize=512)
def _read(text: str) -> Model:
    return read_urdf(text)
