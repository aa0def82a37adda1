"""Services that transfer mesh and texture files by content hash."""

from typing import ClassVar

import msgspec

from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt64

MAX_CHUNK_BYTES = 1 << 20
"""Of a file: hashing and keeping a longer one would make physics late."""
MAX_FILE_BYTES = 64 << 20
MAX_BUNDLE_BYTES = 256 << 20
MAX_BUNDLE_FILES = 512


class AssetRef(msgspec.Struct, frozen=True):
    """A file that a description names."""

    uri: str
    """As the description writes it, such as `package://robot/meshes/base.stl`; see `joined`."""
    sha256: str
    """Of the file's bytes; 64 lower-case hex digits."""


class MissingAssetsRequest(msgspec.Struct, frozen=True):
    """Ask which files the server does not have."""

    ros_type: ClassVar[str] = "zensim/srv/MissingAssets_Request"

    sha256s: tuple[str, ...] = ()


class MissingAssetsResponse(msgspec.Struct, frozen=True):
    """Files that it does not have, and how much of each it has already."""

    ros_type: ClassVar[str] = "zensim/srv/MissingAssets_Response"

    result: Result = Result()
    missing: tuple[str, ...] = ()
    received: tuple[UInt64, ...] = ()
    """Bytes from the start that are there, by place in `missing`: go on from here."""


class PutAssetRequest(msgspec.Struct, frozen=True):
    """Send a piece of a file; pieces follow one another from offset 0."""

    ros_type: ClassVar[str] = "zensim/srv/PutAsset_Request"

    sha256: str = ""
    """Of the whole file."""
    offset: UInt64 = 0
    total: UInt64 = 0
    """Length of the whole file; at most `MAX_FILE_BYTES`."""
    data: bytes = b""
    """At most `MAX_CHUNK_BYTES`."""


class PutAssetResponse(msgspec.Struct, frozen=True):
    """How much of the file is there."""

    ros_type: ClassVar[str] = "zensim/srv/PutAsset_Response"

    result: Result = Result()
    received: UInt64 = 0
    """Bytes from the start; equal to `total` when the file is there and its sha256 is right."""


class GetAssetRequest(msgspec.Struct, frozen=True):
    """Ask for a file that was sent, or for a mesh that the server made of one."""

    ros_type: ClassVar[str] = "zensim/srv/GetAsset_Request"

    sha256: str = ""
    offset: UInt64 = 0


class GetAssetResponse(msgspec.Struct, frozen=True):
    """A piece of it, `MAX_CHUNK_BYTES` at most; a mesh in `Shape.mesh` is a binary STL."""

    ros_type: ClassVar[str] = "zensim/srv/GetAsset_Response"

    result: Result = Result()
    data: bytes = b""
    total: UInt64 = 0


def resolve_include_uri(include: str, uri: str) -> str:
    """Say what a URI means in an SDF model that was included as `include`.

    A relative one is beside the included file: `meshes/a.stl` in `model://crate`, or in
    `model://crate/model.sdf`, is `model://crate/meshes/a.stl`. Any other is itself.
    """
    folder = include.rpartition("/")[0] if include.endswith(".sdf") else include.rstrip("/")
    is_relative = uri and not uri.startswith("/") and "://" not in uri
    return f"{folder}/{uri}" if folder and is_relative else uri
