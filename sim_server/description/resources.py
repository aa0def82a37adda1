"""A spawn request's resource to the text that it stands for. Reads no XML."""

from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.messages.spawn_messages import Resource
from zensim.sim_server.description.library import model_text
from zensim.sim_server.errors import ModelError

SCHEMES = ("model://", "zensim://")


def text_of(resource: Resource) -> str:
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
    return model_text(_shipped_name(resource.uri))


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
