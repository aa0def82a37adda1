"""Mesh conversion: hulls, decimation, split static meshes, and bad files."""

import logging
import struct
from hashlib import sha256

import msgspec
import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.sim_server.description.meshes.test_textures import an_image
from zensim.proto.messages.model_messages import (
    Inertial,
    Joint,
    Link,
    Model,
    Origin,
    Shape,
    Texture,
)
from zensim.proto.stl import read_corners
from zensim.sim_server.description.meshes import mesh_conversion
from zensim.sim_server.description.meshes.convex_hull import MAX_HULL_CORNERS
from zensim.sim_server.description.meshes.mesh_conversion import (
    MAX_PARTS,
    MAX_PIECE_TRIANGLES,
    MAX_STATIC_TRIANGLES_OF_MODEL,
    PLAIN,
    Appearance,
    FindFile,
    MeshConversions,
    Triangles,
    convert_meshes,
    convex_hull,
    decimate,
    read_mesh,
    write_stl,
)
from zensim.sim_server.description.meshes.textures import WHITE, reduce_image
from zensim.sim_server.description.model_geometry import find_wheel_sphere
from zensim.sim_server.errors import ModelError

BLUE = (0.0, 0.0, 1.0, 1.0)
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
    return convert_meshes(model, files.get, conversions), conversions.meshes


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


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("width", [0.2, 0.5, 1.0])
def test_convex_hull_of_a_tyre_with_a_curved_tread_is_a_round_wheel(
    axis: int, width: float
) -> None:
    tyre = trimesh.creation.torus(0.6, 0.4, major_sections=96, minor_sections=48)
    points = np.roll(np.asarray(tyre.vertices) * [1.0, 1.0, width], axis + 1, axis=1)
    hull = convex_hull(Triangles(points + np.array([0.1, 0.2, 0.3]), np.asarray(tyre.faces)))
    joint = Joint("axle", "continuous", "base", "tyre", axis=tuple(np.eye(3)[axis].tolist()))

    sphere = find_wheel_sphere(
        Shape("mesh", (1.0, 1.0, 1.0), Origin((-0.1, -0.2, -0.3)), mesh="tyre"),
        joint,
        lambda _: hull.vertices.astype(np.float32),
    )

    assert len(hull.vertices) <= MAX_HULL_CORNERS
    assert sphere is not None
    assert sphere.size[0] == pytest.approx(1.0, rel=1e-3)


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
    first = convert_meshes(a_model(collisions=(shape,)), files.get, conversions)

    empty = {"a.stl": ("sha", b"")}
    again = convert_meshes(a_model(collisions=(shape,)), empty.get, conversions)

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


OBJ = b"""mtllib look.mtl
v 0 0 0
v 1 0 0
v 1 1 0
v 0 1 0
vt 0 0
vt 1 0
vt 1 1
vt 0 1
usemtl wood
f 1/1 2/2 3/3
usemtl red
f 1 3 4
"""
LOOK = b"newmtl wood\nmap_Kd wood.png\nnewmtl red\nKd 1 0 0\n"


def a_file_finder(**contents: bytes) -> FindFile:
    """Find files by URI; dots and slashes are underscores in the names here."""
    by_name = {name: (sha256(data).hexdigest(), data) for name, data in contents.items()}

    def find(uri: str) -> tuple[str, bytes] | None:
        name = uri.removeprefix("model://")
        return by_name.get(name.replace("/", "_").replace(".", "_"))

    return find


def painted(
    find: FindFile, shape: Shape, *, overrides_materials: bool = True
) -> tuple[Model, dict[str, bytes]]:
    conversions = MeshConversions()
    model = convert_meshes(
        a_model(visuals=(shape,)), find, conversions, overrides_materials=overrides_materials
    )
    return model, conversions.meshes


A_QUAD = Shape("mesh", (1.0, 1.0, 1.0), mesh="model://m/quad.obj")


def test_materials_of_an_obj_become_parts() -> None:
    find = a_file_finder(m_quad_obj=OBJ, m_look_mtl=LOOK, m_wood_png=an_image())

    model, assets = painted(find, A_QUAD)

    wood, red = model.links[0].visuals
    assert (wood.rgba, red.rgba, red.texture) == (WHITE, (1.0, 0.0, 0.0, 1.0), None)
    assert wood.texture is not None
    assert reduce_image(an_image()).data == assets[wood.texture.image]
    points = np.frombuffer(assets[wood.texture.coordinates], "<f4").reshape(-1, 2)
    assert points.tolist() == read_corners(assets[wood.mesh])[:, :2].tolist()


def test_parts_with_mixed_corners_have_no_coordinates() -> None:
    find = a_file_finder(
        m_quad_obj=OBJ.replace(b"f 1 3 4", b"f 1 3/3 4"), m_look_mtl=LOOK, m_wood_png=an_image()
    )

    model, _ = painted(find, A_QUAD)

    assert len(model.links[0].visuals) == 2


def test_missing_texture_is_reported_and_the_mesh_drawn() -> None:
    model, _ = painted(a_file_finder(m_quad_obj=OBJ, m_look_mtl=LOOK), A_QUAD)

    assert [shape.texture for shape in model.links[0].visuals] == [None, None]
    assert [(e.status, e.subject) for e in model.report] == [("ignored", "texture 'wood.png'")]


def test_broken_texture_is_reported_once() -> None:
    find = a_file_finder(m_quad_obj=OBJ, m_look_mtl=LOOK, m_wood_png=b"\x89PNG")
    twice = a_model(visuals=(A_QUAD, A_QUAD))

    model = convert_meshes(twice, find, MeshConversions())

    assert len(model.links[0].visuals) == 4
    assert [entry.status for entry in model.report] == ["ignored"]


@pytest.mark.parametrize(("overrides", "count"), [(True, 1), (False, 2)])
def test_colour_of_a_visual_overrides_materials_in_sdf_only(*, overrides: bool, count: int) -> None:
    find = a_file_finder(m_quad_obj=OBJ, m_look_mtl=LOOK, m_wood_png=an_image())
    shape = msgspec.structs.replace(A_QUAD, rgba=BLUE)

    model, _ = painted(find, shape, overrides_materials=overrides)

    colours = [shape.rgba for shape in model.links[0].visuals]
    assert len(colours) == count
    assert (BLUE in colours) is overrides


def test_image_of_a_visual_covers_its_mesh() -> None:
    find = a_file_finder(m_quad_obj=OBJ.replace(b"f 1 3 4", b"f 1/1 3/3 4/4"), a_png=an_image())
    shape = msgspec.structs.replace(A_QUAD, texture=Texture("a.png"))

    model, assets = painted(find, shape)

    (covered,) = model.links[0].visuals
    assert covered.texture is not None
    assert len(assets[covered.texture.coordinates]) == 2 * 3 * 2 * 4


def test_image_of_a_visual_covers_a_box() -> None:
    shape = Shape("box", (1.0, 1.0, 1.0), texture=Texture("a.png"))

    model, assets = painted(a_file_finder(a_png=an_image()), shape)

    (box,) = model.links[0].visuals
    assert (box.kind, len(read_corners(assets[box.mesh]))) == ("mesh", 36)
    assert box.texture is not None
    assert {box.texture.image, box.texture.coordinates} < assets.keys()


def test_missing_image_of_a_box_is_reported() -> None:
    shape = Shape("box", (1.0, 1.0, 1.0), texture=Texture("a.png"))

    model, assets = painted(a_file_finder(), shape)

    assert (model.links[0].visuals[0].texture, assets) == (None, {})
    assert [entry.status for entry in model.report] == ["ignored"]


def test_images_beyond_the_budget_become_their_mean_colour(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(mesh_conversion, "MAX_IMAGE_BYTES_IN_ALL", 10)
    find = a_file_finder(m_quad_obj=OBJ, m_look_mtl=LOOK, m_wood_png=an_image())

    model, _ = painted(find, A_QUAD)

    colours = [shape.rgba for shape in model.links[0].visuals]
    assert colours == [pytest.approx((1.0, 0.0, 0.0, 1.0), abs=0.02)] * len(colours)
    assert all(shape.texture is None for shape in model.links[0].visuals)


def a_box_with(**material: object) -> trimesh.Trimesh:
    """Make a cube with a material and texture coordinates."""
    box: trimesh.Trimesh = trimesh.creation.box((1.0, 1.0, 1.0))
    points = np.random.default_rng(1).random((8, 2))
    look = trimesh.visual.material.PBRMaterial(**material)  # type: ignore[no-untyped-call]
    box.visual = trimesh.visual.TextureVisuals(points, look)  # type: ignore[no-untyped-call]
    return box


@pytest.mark.parametrize("ending", ["dae", "glb"])
def test_colours_of_a_scene_become_parts(ending: str) -> None:
    red = a_box_with(baseColorFactor=(255, 0, 0, 255))
    green = a_box_with(baseColorFactor=(0, 255, 0, 255)).apply_translation((3.0, 0.0, 0.0))
    data = (
        trimesh.exchange.dae.export_collada([red, green])  # type: ignore[no-untyped-call]
        if ending == "dae"
        else exported(trimesh.Scene([red, green]), ending)
    )
    find = a_file_finder(**{f"s_{ending}": data})

    model, _ = painted(find, Shape("mesh", (1.0, 1.0, 1.0), mesh=f"s.{ending}"))

    colours = {shape.rgba for shape in model.links[0].visuals}
    assert colours == {(1.0, 0.0, 0.0, 1.0), (0.0, 1.0, 0.0, 1.0)}


def test_texture_inside_a_glb_is_used() -> None:
    box = a_box_with(baseColorTexture=Image.new("RGB", (4, 4)))
    find = a_file_finder(s_glb=exported(box, "glb"))

    model, assets = painted(find, Shape("mesh", (1.0, 1.0, 1.0), mesh="s.glb"))

    (shape,) = model.links[0].visuals
    assert shape.texture is not None
    assert shape.texture.image in assets


def test_texture_beside_a_dae_is_used() -> None:
    data = exported(a_box_with(baseColorFactor=(255, 255, 255, 255)), "dae")
    image = b"<image id='i'><init_from>../tex/a.png</init_from></image>"
    image = b"<library_images>" + image + b"</library_images>"
    sampler = (
        b"<newparam sid='s'><surface type='2D'><init_from>i</init_from></surface></newparam>"
        b"<newparam sid='t'><sampler2D><source>s</source></sampler2D></newparam><technique"
    )
    data = data.replace(b"<library_effects>", image + b"<library_effects>")
    data = data.replace(b"<technique", sampler, 1)
    start = data.index(b"<diffuse>") + len(b"<diffuse>")
    end = data.index(b"</diffuse>")
    data = data[:start] + b"<texture texture='t' texcoord='UVSET0'/>" + data[end:]
    find = a_file_finder(r_meshes_a_dae=data, r_tex_a_png=an_image())

    model, assets = painted(find, Shape("mesh", (1.0, 1.0, 1.0), mesh="model://r/meshes/a.dae"))

    (shape,) = model.links[0].visuals
    assert shape.texture is not None
    assert assets[shape.texture.image] == reduce_image(an_image()).data


def test_decimated_mesh_keeps_coordinates_of_its_triangles() -> None:
    ball = trimesh.creation.icosphere(6)
    faces = np.asarray(ball.faces)
    points = np.asarray(ball.vertices)[faces][:, :, :2].astype(np.float32)
    looks = Appearance((PLAIN,), np.zeros(len(faces), np.int64), points)

    drawn = decimate(Triangles(np.asarray(ball.vertices), faces, looks), 20_000)

    assert drawn.appearance is not None
    assert drawn.appearance.coordinates.shape == (len(drawn.faces), 3, 2)
    moved = drawn.vertices[drawn.faces][:, :, :2] - drawn.appearance.coordinates
    assert float(np.abs(moved).max()) < 0.1


def test_materials_beyond_the_limit_share_a_part() -> None:
    count = MAX_PARTS + 10
    lines = [b"mtllib l.mtl", *(b"v %d 0 0\nv %d 1 0\nv %d 0 1" % (i, i, i) for i in range(count))]
    lines += [
        b"usemtl m%d\nf %d %d %d" % (i, 3 * i + 1, 3 * i + 2, 3 * i + 3) for i in range(count)
    ]
    text = b"\n".join(b"newmtl m%d\nKd %f 0 0" % (i, i / count) for i in range(count))
    find = a_file_finder(a_obj=b"\n".join(lines), l_mtl=text)

    model, assets = painted(find, Shape("mesh", (1.0, 1.0, 1.0), mesh="a.obj"))

    parts = model.links[0].visuals
    assert len(parts) == MAX_PARTS
    assert sum(len(read_corners(assets[part.mesh])) for part in parts) == 3 * count
