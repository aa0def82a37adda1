"""Messages between server and parser process: MessagePack in frames on pipes."""

from __future__ import annotations

import msgspec

from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.drive_messages import DriveOrder
from zensim.proto.messages.model_messages import Dynamics, Model
from zensim.proto.messages.spawn_messages import Compat
from zensim.sim_server.description.world_model import WorldModel

MAX_CPU_S = 7
"""CPU time of the parser process for each request; up to a second more is counted."""


class ParseRequest(msgspec.Struct, frozen=True):
    """A text to parse; a frame with the content of each of `files` follows, in their order."""

    number: int
    text: str
    compat: Compat = "fixed"
    allow_missing: bool = False
    assets: tuple[AssetRef, ...] = ()
    dynamics: Dynamics = ""
    controllers: tuple[str, ...] = ()
    drive: DriveOrder = DriveOrder()
    files: tuple[str, ...] = ()
    """SHA-256 of the files, each once."""
    is_world: bool = False
    """Whether the text is a world; `assets` then name its models, too."""


class ParserReady(msgspec.Struct, frozen=True, tag=True):
    """Sent once, when imports are done and privileges are dropped."""


class ParsedMesh(msgspec.Struct, frozen=True, tag=True):
    """A mesh of a model; sent before the model."""

    sha256: str
    data: bytes


class ParseResult(msgspec.Struct, frozen=True, tag=True):
    """A model or a world, or the error."""

    number: int
    model: Model | None = None
    code: int = 0
    slug: str = ""
    message: str = ""
    """Message without the slug."""
    world: WorldModel | None = None
    wanted: tuple[str, ...] = ()
    """URIs that a world names and the assets lack."""
    unusable: tuple[str, ...] = ()
    """Why meshes of a world could not be read."""


ParserMessage = ParserReady | ParsedMesh | ParseResult
