"""Mesh conversion: hulls, decimation, split static meshes, and bad files."""

import logging
import struct

import numpy as np
import pytest
import trimesh

from zensim.proto.messages.model_messages import Inertial, Link, Model, Shape
from zensim.sim_server.description.meshes.mesh_conversion import (
    MAX_HULL_CORNERS,
    MAX_PIECE_TRIANGLES,
    MAX_STATIC_TRIANGLES_OF_MODEL,
    MeshConversions,
    Triangles,
    convert_meshes,
    convex_hull,
    decimate,
    read_mesh,
    write_stl,
)
from zensim.sim_server.errors import ModelError

BOX = trimesh.creation.box((1.0, 2.0, 3.0))
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


def exported(mesh: trimesh.Trimesh | trimesh.Scene, ending: str) -> bytes:
    data = mesh.export(file_type=ending)
    if isinstance(data, str):
        return data.encode()
    assert isinstance(data, bytes)
    return data


def extents(triangles: Triangles) -> list[float]:
    found: list[float] = np.ptp(triangles.vertices, axis=0).round(6).tolist()
    return found


def a_model(
    *,
    is_static: bool = False,
    collisions: tuple[Shape, ...] = (),
    visuals: tuple[Shape, ...] = (),
) -> Model:
    return Model("m", (Link("base", Inertial(1.0), collisions, visuals),), is_static=is_static)


def converted(model: Model, files: dict[str, tuple[str, bytes]]) -> tuple[Model, dict[str, bytes]]:
    conversions = MeshConversions()
    return convert_meshes(model, files, conversions), conversions.meshes


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


def test_convex_hull_of_a_box_is_the_box() -> None:
    fine = BOX.subdivide().subdivide().subdivide().subdivide()
    hull = convex_hull(Triangles(np.asarray(fine.vertices), np.asarray(fine.faces)))

    assert len(hull.vertices) == 8
    assert trimesh.Trimesh(hull.vertices, hull.faces).volume == pytest.approx(6.0)


def test_convex_hull_has_few_corners_when_the_mesh_has_many() -> None:
    ball = trimesh.creation.icosphere(subdivisions=5)
    hull = convex_hull(Triangles(np.asarray(ball.vertices), np.asarray(ball.faces)))

    assert len(hull.vertices) <= MAX_HULL_CORNERS
    assert trimesh.Trimesh(hull.vertices, hull.faces).volume == pytest.approx(ball.volume, rel=0.12)


@pytest.mark.parametrize("corner", [(0.0, 1.0, 0.0), (2.0, 0.0, 0.0), (0.0, 0.0, 0.0)])
def test_convex_hull_of_a_flat_mesh_is_thickened(corner: tuple[float, float, float]) -> None:
    flat = Triangles(np.array([[0.0, 0, 0], [1, 0, 0], corner]), np.array([[0, 1, 2]]))

    hull = convex_hull(flat)

    assert trimesh.Trimesh(hull.vertices, hull.faces).volume > 0.0


def test_mesh_becomes_a_hull_for_collisions_and_triangles_for_visuals() -> None:
    shape = Shape("mesh", (1.0, -1.0, 1.0), mesh="a.stl")
    data = exported(trimesh.creation.torus(1.0, 0.3), "stl")

    model, meshes = converted(
        a_model(collisions=(shape,), visuals=(shape,)), {"a.stl": ("sha", data)}
    )

    link = model.links[0]
    assert {link.collisions[0].mesh, link.visuals[0].mesh} == set(meshes)
    assert len(meshes[link.collisions[0].mesh]) < len(meshes[link.visuals[0].mesh])
    assert link.collisions[0].size == (1.0, -1.0, 1.0)


def test_static_mesh_is_not_replaced_by_its_hull() -> None:
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="a.stl")
    data = exported(trimesh.creation.torus(1.0, 0.3), "stl")

    model, meshes = converted(
        a_model(collisions=(shape,), is_static=True), {"a.stl": ("sha", data)}
    )

    assert len(meshes[model.links[0].collisions[0].mesh]) == len(data)


def test_bad_visual_mesh_is_left_out_and_reported_once() -> None:
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="a.stl")

    model, meshes = converted(a_model(visuals=(shape,)), {"a.stl": ("sha", b"garbage")})

    assert (model.links[0].visuals, meshes) == ((), {})
    assert [entry.status for entry in model.report] == ["suspicious"]


def test_bad_collision_mesh_refuses_the_model() -> None:
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="a.stl")

    with pytest.raises(ModelError, match=r"^mesh\.length"):
        converted(a_model(collisions=(shape,)), {"a.stl": ("sha", b"garbage")})


def test_models_share_converted_meshes() -> None:
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="a.stl")
    files, conversions = {"a.stl": ("sha", exported(BOX, "stl"))}, MeshConversions()
    first = convert_meshes(a_model(collisions=(shape,)), files, conversions)

    again = convert_meshes(a_model(collisions=(shape,)), {"a.stl": ("sha", b"")}, conversions)

    assert first == again
    assert len(conversions.meshes) == 1


def test_written_stl_is_read_back() -> None:
    triangles = Triangles(np.asarray(BOX.vertices), np.asarray(BOX.faces))

    again = read_mesh("a.stl", write_stl(triangles))

    assert np.array_equal(again.vertices.reshape(-1, 3, 3), triangles.vertices[triangles.faces])


def test_large_static_mesh_is_split_into_pieces() -> None:
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="a.stl")
    torus = trimesh.creation.torus(1.0, 0.3, major_sections=100, minor_sections=60)

    model, meshes = converted(
        a_model(collisions=(shape,), is_static=True), {"a.stl": ("sha", exported(torus, "stl"))}
    )

    parts = [read_mesh("a.stl", meshes[part.mesh]) for part in model.links[0].collisions]
    assert max(len(part.faces) for part in parts) <= MAX_PIECE_TRIANGLES
    assert sum(len(part.faces) for part in parts) == len(torus.faces)
    assert sum(area(part) for part in parts) == pytest.approx(torus.area, rel=1e-4)


def area(triangles: Triangles) -> float:
    return float(trimesh.Trimesh(triangles.vertices, triangles.faces, process=False).area)


def test_static_meshes_share_the_maximum_count_of_triangles() -> None:
    shapes = tuple(Shape("mesh", (1.0, 1.0, 1.0), mesh="a.stl") for _ in range(100))
    torus = trimesh.creation.torus(1.0, 0.3, major_sections=100, minor_sections=60)

    model, meshes = converted(
        a_model(collisions=shapes, is_static=True), {"a.stl": ("sha", exported(torus, "stl"))}
    )

    names = [part.mesh for part in model.links[0].collisions]
    counts = [len(read_mesh("a.stl", meshes[name]).faces) for name in names]
    assert sum(counts) <= MAX_STATIC_TRIANGLES_OF_MODEL
    (entry,) = model.report
    assert entry.subject == "mesh 'a.stl'"
    assert str(len(torus.faces)) in entry.reason


MOST = 20_000


def of(mesh: trimesh.Trimesh) -> Triangles:
    return Triangles(np.asarray(mesh.vertices), np.asarray(mesh.faces))


def bounding_box(found: Triangles) -> list[float]:
    reach: list[float] = np.ptp(found.vertices, axis=0).tolist()
    return reach


def test_decimation_keeps_the_shape_of_a_mesh() -> None:
    ball = of(trimesh.creation.icosphere(subdivisions=7))

    drawn = decimate(ball, MOST)

    assert MOST / 10 < len(drawn.faces) <= MOST
    assert bounding_box(drawn) == pytest.approx([2.0, 2.0, 2.0], abs=0.02)


def test_decimation_returns_a_coarse_mesh_unchanged() -> None:
    box = of(trimesh.creation.box())

    assert decimate(box, 12) is box


@pytest.mark.parametrize(("radius_m", "least", "most"), [(0.01, 50, 1000), (0.2, 10_000, MOST)])
def test_decimation_uses_the_finest_possible_grid(radius_m: float, least: int, most: int) -> None:
    ball = of(trimesh.creation.icosphere(subdivisions=5, radius=radius_m))
    far = [[-1.0, -1.0, -1.0], [-1.0, -0.99, -1.0], [-1.0, -1.0, -0.99]]
    corners = np.concatenate([ball.vertices, far])
    faces = np.concatenate([ball.faces, [[len(corners) - 3, len(corners) - 2, len(corners) - 1]]])

    drawn = decimate(Triangles(corners, faces), MOST)

    assert least < len(drawn.faces) < most


def test_decimation_drops_triangles_without_common_corners() -> None:
    corners = np.random.default_rng(0).random((9000, 3))

    found = decimate(Triangles(corners, np.arange(9000).reshape(-1, 3)), 100)

    assert (len(found.faces), found.faces.max() < len(found.vertices)) == (100, True)


def test_missing_texture_of_a_mesh_is_not_logged(caplog: pytest.LogCaptureFixture) -> None:
    read_mesh("box.dae", exported(BOX, "dae"))

    logging.getLogger("trimesh").warning("unable to load bumpmap")

    assert caplog.records == []
