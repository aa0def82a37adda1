"""Services that transfer mesh and texture files by content hash."""

import posixpath
import re
from typing import ClassVar, Final, NamedTuple
from urllib.parse import unquote

import msgspec

from zensim.proto.messages.result_messages import Result
from zensim.proto.messages.scalar_types import UInt64

MAX_CHUNK_BYTES = 1 << 20
"""Part of a file in one message: a longer one would delay the physics step."""
MAX_FILE_BYTES = 64 << 20
MAX_BUNDLE_BYTES = 256 << 20
MAX_BUNDLE_FILES = 512


class AssetRef(msgspec.Struct, frozen=True):
    """A file that a description refers to."""

    uri: str
    """URI in the description: `package://robot/meshes/base.stl`; see `resolve_include_uri`."""
    sha256: str
    """64 lower-case hex digits."""


class MissingAssetsRequest(msgspec.Struct, frozen=True):
    """Find files that the server does not have."""

    ros_type: ClassVar[str] = "zensim/srv/MissingAssets_Request"

    sha256s: tuple[str, ...] = ()


class MissingAssetsResponse(msgspec.Struct, frozen=True):
    """Missing files, and how many bytes of each the server has."""

    ros_type: ClassVar[str] = "zensim/srv/MissingAssets_Response"

    result: Result = Result()
    missing: tuple[str, ...] = ()
    received: tuple[UInt64, ...] = ()
    """Bytes from the start, in the order of `missing`: continue at this offset."""


class PutAssetRequest(msgspec.Struct, frozen=True):
    """Upload a part of a file; parts are in order, from offset 0."""

    ros_type: ClassVar[str] = "zensim/srv/PutAsset_Request"

    sha256: str = ""
    """SHA-256 of the whole file."""
    offset: UInt64 = 0
    total: UInt64 = 0
    """Size of the whole file; at most `MAX_FILE_BYTES`."""
    data: bytes = b""
    """Part of the file; at most `MAX_CHUNK_BYTES`."""


class PutAssetResponse(msgspec.Struct, frozen=True):
    """Progress of an upload."""

    ros_type: ClassVar[str] = "zensim/srv/PutAsset_Response"

    result: Result = Result()
    received: UInt64 = 0
    """Bytes from the start; equal to `total` if the file is complete and its sha256 is correct."""


class GetAssetRequest(msgspec.Struct, frozen=True):
    """Download an uploaded file, or a mesh that the server generated."""

    ros_type: ClassVar[str] = "zensim/srv/GetAsset_Request"

    sha256: str = ""
    offset: UInt64 = 0


class GetAssetResponse(msgspec.Struct, frozen=True):
    """Part of a file, at most `MAX_CHUNK_BYTES`; for the formats see `Shape.mesh` and `Texture`."""

    ros_type: ClassVar[str] = "zensim/srv/GetAsset_Response"

    result: Result = Result()
    data: bytes = b""
    total: UInt64 = 0


def resolve_include_uri(include: str, uri: str) -> str:
    """Resolve a URI in an SDF model that was included as `include`.

    A relative one is relative to the included file: `meshes/a.stl` in `model://crate`, or in
    `model://crate/model.sdf`, is `model://crate/meshes/a.stl`, as is `//meshes/a.stl`, which joins
    an empty folder. Others are returned unchanged.
    """
    folder = include.rpartition("/")[0] if include.endswith(".sdf") else include.rstrip("/")
    is_relative = uri and (uri[0] != "/" or uri[:2] == "//") and "://" not in uri
    return f"{folder}/{uri.lstrip('/')}" if folder and is_relative else uri


IMAGE_SUFFIXES: Final = (".png", ".jpg", ".jpeg", ".tga", ".bmp")
MATERIAL_SUFFIX: Final = ".mtl"
"""Suffix of a file with the materials of an OBJ file."""
_REFERENCES: Final = {
    ".dae": re.compile(rb"<init_from>\s*(?:<ref>\s*)?([^<]{1,500}?)\s*</"),
    ".obj": re.compile(rb"^[ \t]*mtllib[ \t]+(\S[^\r\n]{0,500})", re.MULTILINE),
    MATERIAL_SUFFIX: re.compile(rb"^[ \t]*map_Kd[ \t]+(\S[^\r\n]{0,500})", re.MULTILINE),
}
MAX_REFERENCES: Final = 64
"""Images and material files of one file."""
_TEXTURE_FOLDER: Final = "../materials/textures"


def list_references(uri: str, data: bytes) -> tuple[str, ...]:
    """List the images and material files that a mesh or material file names, as written there."""
    pattern = _REFERENCES.get(posixpath.splitext(uri)[1].lower())
    found = pattern.findall(data) if pattern is not None else ()
    names = (name.decode("utf-8", "replace").strip() for name in found)
    kept = (name for name in names if name.lower().endswith((*IMAGE_SUFFIXES, MATERIAL_SUFFIX)))
    return tuple(dict.fromkeys(kept))[:MAX_REFERENCES]


def list_reference_uris(owner: str, reference: str) -> tuple[str, ...]:
    """List the URIs at which a file may be that the file `owner` names, best first.

    A path is relative to the owner; as in Gazebo, the name alone is also searched beside the owner
    and in `../materials/textures`: exporters write paths of their own host.
    """
    scheme, separator, path = owner.rpartition("://")
    name = unquote(reference.rpartition(" ")[2] if reference.startswith("-") else reference)
    name = name.replace("\\", "/").removeprefix("file://")
    if "://" in name:
        return (name,)
    folder, base = posixpath.dirname(path), posixpath.basename(name)
    is_relative = not name.startswith("/") and ":" not in name
    paths = [name] if is_relative else []
    paths += [base, f"{_TEXTURE_FOLDER}/{base}"]
    whole = (posixpath.normpath(posixpath.join(folder, one)) for one in paths)
    return tuple(dict.fromkeys(f"{scheme}{separator}{one}" for one in whole))


FUEL_URI = re.compile(
    r"https?://[^/]+/(?:[^/]+/)*?models/(?P<name>[^/]+)(?:/(?:\d+|tip))?(?:/files)?(?:/(?P<file>.+))?"
)


class FuelUri(NamedTuple):
    """A model of Gazebo Fuel, and a file in it; `file` is empty for the model itself."""

    name: str
    file: str


def parse_fuel_uri(uri: str) -> FuelUri | None:
    """Parse `https://HOST/1.0/OWNER/models/NAME[/VERSION][/files/FILE]`; None for other URIs."""
    found = FUEL_URI.fullmatch(uri.strip().rstrip("/"))
    return FuelUri(unquote(found["name"]), unquote(found["file"] or "")) if found else None


def normalize_model_name(name: str) -> str:
    """Make the same text of names that differ in case, or in spaces and `_`, only."""
    return name.strip().lower().replace(" ", "_")
