"""Meshes with a texture as binary glTF, which the page loads."""

import struct
from typing import Final

import msgspec
import numpy as np

from zensim.spawner.page.model_visuals import ColouredMesh, TriangleMesh

GLB_MAGIC: Final = b"glTF"
GLB_VERSION: Final = 2
FLOAT, UNSIGNED_INT = 5126, 5125
"""Component types of glTF 2.0."""
PNG_START: Final = b"\x89PNG"
SRGB_EXPONENT: Final = 2.2


def encode_glb(part: ColouredMesh) -> bytes:
    """Encode a mesh with a texture as binary glTF 2.0."""
    mesh = part.mesh
    assert mesh.coordinates is not None, "the mesh has no texture"
    # In glTF, v points downward.
    points = mesh.coordinates * (1.0, -1.0) + (0.0, 1.0)
    vertices = mesh.vertices.astype("<f4")
    blobs = [vertices.tobytes(), points.astype("<f4").tobytes(), mesh.faces.astype("<u4").tobytes()]
    blobs.append(mesh.image)
    starts = np.cumsum([0, *map(_find_padded_length, blobs)]).tolist()
    views = [
        {"buffer": 0, "byteOffset": start, "byteLength": len(blob)}
        for start, blob in zip(starts, blobs, strict=False)
    ]
    attributes = {"POSITION": 0, "TEXCOORD_0": 1}
    bounds = {"min": vertices.min(axis=0).tolist(), "max": vertices.max(axis=0).tolist()}
    content = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": attributes, "indices": 2, "material": 0}]}],
        "accessors": [
            {**_describe_array(0, FLOAT, len(vertices), "VEC3"), **bounds},
            _describe_array(1, FLOAT, len(points), "VEC2"),
            _describe_array(2, UNSIGNED_INT, mesh.faces.size, "SCALAR"),
        ],
        "materials": [_describe_material(part)],
        "textures": [{"source": 0}],
        "images": [{"bufferView": 3, "mimeType": "image/png" if _is_png(mesh) else "image/jpeg"}],
        "buffers": [{"byteLength": starts[-1]}],
        "bufferViews": views,
    }
    return _pack_glb(msgspec.json.encode(content), b"".join(map(_pad_with_zeros, blobs)))


def _describe_array(view: int, component: int, count: int, kind: str) -> dict[str, object]:
    return {"bufferView": view, "componentType": component, "count": count, "type": kind}


def _describe_material(part: ColouredMesh) -> dict[str, object]:
    """Describe a matt material; glTF has linear colours."""
    factor = [*(channel**SRGB_EXPONENT for channel in part.rgba[:3]), part.rgba[3]]
    surface = {
        "baseColorFactor": factor,
        "baseColorTexture": {"index": 0},
        "metallicFactor": 0.0,
        "roughnessFactor": 1.0,
    }
    # Only images with transparent parts are PNG.
    mode = "BLEND" if part.rgba[3] < 1.0 else "MASK" if _is_png(part.mesh) else "OPAQUE"
    return {"pbrMetallicRoughness": surface, "alphaMode": mode, "doubleSided": True}


def _is_png(mesh: TriangleMesh) -> bool:
    return mesh.image.startswith(PNG_START)


def _pack_glb(head: bytes, body: bytes) -> bytes:
    head = head.ljust(_find_padded_length(head))
    chunks = struct.pack("<I4s", len(head), b"JSON") + head
    chunks += struct.pack("<I4s", len(body), b"BIN\0") + body
    return GLB_MAGIC + struct.pack("<II", GLB_VERSION, 12 + len(chunks)) + chunks


def _find_padded_length(data: bytes) -> int:
    return -(-len(data) // 4) * 4


def _pad_with_zeros(data: bytes) -> bytes:
    return data.ljust(_find_padded_length(data), b"\0")
