"""Mesh files of each format, bad ones, and pointers of Git LFS."""

import struct

import numpy as np
import pytest

from tests.sim_server.description.meshes.mesh_samples import BOX, exported
from zensim.proto.messages.result_messages import SpawnCode
from zensim.proto.stl import write_corners
from zensim.sim_server.description.meshes.mesh_reader import read_mesh
from zensim.sim_server.description.meshes.mesh_triangles import Triangles
from zensim.sim_server.errors import ModelError

ASCII = b"""solid t
facet normal 0 0 1
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 1e0 0
endloop
endfacet
endsolid t
"""

POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n"


def extents(triangles: Triangles) -> list[float]:
    found: list[float] = np.ptp(triangles.vertices, axis=0).round(6).tolist()
    return found


@pytest.mark.parametrize("ending", ["stl", "obj", "dae", "glb"])
def test_read_mesh_reads_each_format(ending: str) -> None:
    found = read_mesh(f"package://p/box.{ending.upper()}", exported(BOX, ending))

    assert len(found.faces) == 12
    assert extents(found) == [1.0, 2.0, 3.0]


def test_read_mesh_reads_ascii_stl() -> None:
    assert extents(read_mesh("a.stl", ASCII)) == [1.0, 1.0, 0.0]


def test_read_mesh_applies_the_unit_of_a_dae() -> None:
    data = exported(BOX, "dae").replace(b"</asset>", b'<unit meter="0.001"/></asset>')

    assert extents(read_mesh("a.dae", data)) == [0.001, 0.002, 0.003]


@pytest.mark.parametrize(
    ("name", "data", "slug"),
    [
        ("a.step", b"x", "mesh.format"),
        ("a", b"x", "mesh.format"),
        ("a.stl", b"", "mesh.length"),
        ("a.stl", bytes(84), "mesh.empty"),
        ("a.stl", bytes(80) + struct.pack("<I", 10) + bytes(50), "mesh.length"),
        ("a.stl", bytes(80) + struct.pack("<I", 0xFFFFFFFF) + bytes(50), "mesh.length"),
        ("a.stl", exported(BOX, "stl")[:-1], "mesh.length"),
        ("a.stl", ASCII.replace(b"1e0", b"nan"), "mesh.number"),
        ("a.stl", ASCII.replace(b"1e0", b"one"), "mesh.number"),
        ("a.stl", ASCII.replace(b"1e0", b"1e9"), "mesh.extent"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nf 1 2 9\n", "mesh.index"),
        ("a.obj", b"v 0 0 0\nf 1 -7 1\n", "mesh.index"),
        ("a.obj", b"v 0 0\n", "mesh.unreadable"),
        ("a.obj", b"mtllib /etc/passwd\n", "mesh.empty"),
        ("a.dae", b"<!DOCTYPE x [<!ENTITY a 'b'>]><COLLADA/>", "mesh.doctype"),
        ("a.dae", b"<COLLADA", "mesh.unreadable"),
        ("a.glb", b"glTF" + bytes(40), "mesh.unreadable"),
    ],
)
def test_read_mesh_refuses_a_bad_file(name: str, data: bytes, slug: str) -> None:
    with pytest.raises(ModelError, match=repr(name)) as caught:
        read_mesh(name, data)

    assert caught.value.slug == slug


@pytest.mark.parametrize("ending", ["stl", "obj", "dae", "glb"])
def test_read_mesh_names_a_pointer_of_git_lfs(ending: str) -> None:
    with pytest.raises(ModelError, match=f"a\\.{ending}") as caught:
        read_mesh(f"a.{ending}", POINTER)

    assert (caught.value.slug, caught.value.code) == ("mesh.lfs", SpawnCode.MISSING_ASSETS)


def test_written_stl_is_read_back() -> None:
    triangles = Triangles(np.asarray(BOX.vertices), np.asarray(BOX.faces))

    again = read_mesh("a.stl", write_corners(triangles.corners))

    assert np.array_equal(again.vertices.reshape(-1, 3, 3), triangles.vertices[triangles.faces])
