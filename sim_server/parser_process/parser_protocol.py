"""Messages between server and parser process: length-prefixed MessagePack frames on pipes."""

from __future__ import annotations

import struct

import msgspec

from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.model_messages import Dynamics, Model
from zensim.proto.messages.spawn_messages import Compat
from zensim.sim_server.description.sdf.sdf_world import WorldModel

FRAME_LENGTH = struct.Struct("<Q")
"""Stands before each frame."""


class ParseRequest(msgspec.Struct, frozen=True):
    """A text to read; a raw frame for each of `files` follows, in their order."""

    number: int
    text: str
    compat: Compat = "fixed"
    allow_missing: bool = False
    assets: tuple[AssetRef, ...] = ()
    dynamics: Dynamics = ""
    files: tuple[str, ...] = ()
    """Their sha256, each once."""
    is_world: bool = False
    """Whether the text is a world's; `assets` then name its models, too."""


class ParserReady(msgspec.Struct, frozen=True, tag=True):
    """Said once, when the reader has imported what it needs and has given up its rights."""


class ParsedMesh(msgspec.Struct, frozen=True, tag=True):
    """A mesh that a model names, said before the model."""

    sha256: str
    data: bytes


class ParseResult(msgspec.Struct, frozen=True, tag=True):
    """The model or the world, or why there is none."""

    number: int
    model: Model | None = None
    code: int = 0
    slug: str = ""
    message: str = ""
    """Without the slug."""
    world: WorldModel | None = None
    wanted: tuple[str, ...] = ()
    """URIs that a world names and that were not among the assets."""
    unusable: tuple[str, ...] = ()
    """Why meshes of a world could not be read."""


ParserMessage = ParserReady | ParsedMesh | ParseResult


def encode_frame(message: msgspec.Struct) -> bytes:
    """Write a frame."""
    payload = msgspec.msgpack.encode(message)
    return FRAME_LENGTH.pack(len(payload)) + payload
