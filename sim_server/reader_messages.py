"""What server and reader process say to one another: frames of MessagePack on pipes."""

from __future__ import annotations

import struct

import msgspec

from proto.assets import AssetRef
from proto.model import Model
from proto.services import Compat

LENGTH = struct.Struct("<Q")
"""Stands before each frame."""


class ReadRequest(msgspec.Struct, frozen=True):
    """A text to read; a raw frame for each of `files` follows, in their order."""

    number: int
    text: str
    compat: Compat = "fixed"
    allow_missing: bool = False
    assets: tuple[AssetRef, ...] = ()
    files: tuple[str, ...] = ()
    """Their sha256, each once."""


class ReaderReady(msgspec.Struct, frozen=True, tag=True):
    """Said once, when the reader has imported what it needs and has given up its rights."""


class MeshMade(msgspec.Struct, frozen=True, tag=True):
    """A mesh that a model names, said before the model."""

    sha256: str
    data: bytes


class TextRead(msgspec.Struct, frozen=True, tag=True):
    """The model, or why there is none."""

    number: int
    model: Model | None = None
    code: int = 0
    slug: str = ""
    message: str = ""
    """Without the slug."""


ReaderMessage = ReaderReady | MeshMade | TextRead


def framed(message: msgspec.Struct) -> bytes:
    """Write a frame."""
    payload = msgspec.msgpack.encode(message)
    return LENGTH.pack(len(payload)) + payload
