"""Mesh conversion: hulls, decimation, split static meshes, and bad files."""

from hashlib import sha256

import msgspec
import numpy as np
import pytest
import trimesh
from PIL import Image

from tests.sim_server.description.meshes.mesh_samples import BOX, exported
from tests.sim_server.description.meshes.test_textures import an_image
from zensim.proto.messages.model_messages import Inertial, Link, Model, Shape, Texture
from zensim.proto.stl import read_corners
from zensim.sim_server.description.meshes import mesh_conversion
from zensim.sim_server.description.meshes.mesh_conversion import (
    MAX_PARTS,
    MAX_PIECE_TRIANGLES,
    MAX_STATIC_TRIANGLES_OF_MODEL,
    MeshConversions,
    convert_meshes,
)
from zensim.sim_server.description.meshes.mesh_reader import read_mesh
from zensim.sim_server.description.meshes.mesh_triangles import FindFile, Triangles
from zensim.sim_server.description.meshes.textures import WHITE, reduce_image
from zensim.sim_server.errors import ModelError

BLUE = (0.0, 0.0, 1.0, 1.0)


def a_model(
    *, is_static: bool = False, collisions: tuple[Shape, ...] = (), visuals: tuple[Shape, ...] = ()
) -> Model:
    return Model("m", (Link("base", Inertial(1.0), collisions, visuals),), is_static=is_static)


def converted(model: Model, files: dict[str, tuple[str, bytes]]) -> tuple[Model, dict[str, bytes]]:
    conversions = MeshConversions()
    return convert_meshes(model, files.get, conversions), conversions.meshes


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


def test_pointer_of_git_lfs_is_not_drawn_and_named() -> None:
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="a.dae")
    data = b"version https://git-lfs.github.com/spec/v1\n"

    model, _ = converted(a_model(visuals=(shape,)), {"a.dae": ("sha", data)})

    (entry,) = model.report
    assert entry.status == "suspicious"
    assert "git lfs pull" in entry.reason


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


def test_images_beyond_the_budget_become_their_mean_colour(monkeypatch: pytest.MonkeyPatch) -> None:
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
