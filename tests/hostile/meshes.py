"""Large mesh files, each with another reason for refusal."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from zensim.proto.stl import write_corners

BYTES = 1 << 20
SEED = 7


@dataclass(frozen=True)
class BadMesh:
    """A mesh file.

    Attributes:
        slug: Of the refusal.
    """

    name: str
    data: bytes
    slug: str


def bad_meshes() -> Iterator[BadMesh]:
    """Make mesh files of each format."""
    rng = np.random.default_rng(SEED)
    noise = rng.bytes(BYTES)
    corners = np.full((BYTES // 50, 3, 3), np.nan)
    yield BadMesh("noise.stl", noise, "mesh.length")
    yield BadMesh("nan.stl", write_corners(corners), "mesh.number")
    yield BadMesh("words.obj", b"v one two three\n" * (BYTES // 16), "mesh.unreadable")
    yield BadMesh("index.obj", b"v 0 0 0\n" + b"f 1 2 999\n" * (BYTES // 10), "mesh.index")
    yield BadMesh("empty.obj", b"v 0.5 0.5 0.5\n" * (BYTES // 14), "mesh.empty")
    yield BadMesh("deep.dae", b"<a>" * (BYTES // 3), "mesh.unreadable")
    yield BadMesh("noise.dae", noise, "mesh.doctype")
    laughs = b'<!DOCTYPE a [<!ENTITY b "c">]><a>' + b"&b;" * (BYTES // 3) + b"</a>"
    yield BadMesh("entities.dae", laughs, "mesh.doctype")
    yield BadMesh("noise.glb", noise, "mesh.unreadable")
    yield BadMesh("deep.glb", _glb(b"[" * BYTES), "mesh.unreadable")


def _glb(text: bytes) -> bytes:
    chunk = len(text).to_bytes(4, "little") + b"JSON" + text
    return b"glTF" + (2).to_bytes(4, "little") + (12 + len(chunk)).to_bytes(4, "little") + chunk
