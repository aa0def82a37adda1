"""Visual templates, link poses and triangle meshes."""

from collections import Counter

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.spawner.page.builders import BLUE, CUBE, make_robot
from zensim.proto.messages.model_messages import (
    Joint,
    JointKind,
    Light,
    Link,
    Model,
    Origin,
    Shape,
    Texture,
)
from zensim.proto.rigid_transforms import normalize
from zensim.proto.se3 import from_rpy
from zensim.spawner.page.model_visuals import (
    DEFAULT_RGBA,
    NotATree,
    TriangleMesh,
    VisualJoint,
    find_link_poses,
    find_mesh_name,
    make_box,
    make_capsule,
    make_cylinder,
    make_link_meshes,
    make_shape_mesh,
    make_template,
    make_textured_mesh,
    merge_meshes,
    weld_triangles,
)

SQUARE = np.array(
    [[0, 0, 0], [1, 0, 0], [1, 1, 0], [-0.0, 0, 0], [1, 1, 0], [0, 1, 0]], dtype=np.float32
)


def test_equal_corners_become_one_vertex() -> None:
    mesh = weld_triangles(SQUARE)

    assert len(mesh.vertices) == 4
    assert np.array_equal(mesh.vertices[mesh.faces.reshape(-1)], SQUARE)


def test_different_corners_stay_separate() -> None:
    corners = np.random.default_rng(0).normal(size=(30_000, 3)).astype(np.float32)

    mesh = weld_triangles(corners)

    assert len(mesh.vertices) == 30_000
    assert np.array_equal(mesh.vertices[mesh.faces.reshape(-1)], corners)


METRES = st.floats(-3.0, 3.0)
RADIANS = st.floats(-3.0, 3.0)
VECTORS = st.tuples(METRES, METRES, METRES)
TURNS = st.tuples(RADIANS, RADIANS, RADIANS)
AXES = VECTORS.filter(lambda axis: np.linalg.norm(axis) > 0.1)
KIND_NAMES: tuple[JointKind, ...] = ("revolute", "continuous", "prismatic", "fixed")
KINDS = st.sampled_from(KIND_NAMES)
REST = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))


@st.composite
def trees(draw: st.DrawFn) -> tuple[VisualJoint, ...]:
    return tuple(
        VisualJoint(
            draw(KINDS),
            draw(st.integers(0, number)),
            Origin(draw(VECTORS), tuple(from_rpy(*draw(TURNS)))),
            normalize(draw(AXES)),
        )
        for number in range(draw(st.integers(1, 5)))
    )


def make_matrix(position: np.ndarray, quaternion: np.ndarray) -> np.ndarray:
    x, y, z, w = quaternion
    matrix = np.eye(4)
    matrix[:3, 3] = position
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    return matrix


def make_motion(kind: JointKind, axis: np.ndarray, position: float) -> np.ndarray:
    """Apply Rodrigues' formula, or shift along the axis."""
    matrix, (x, y, z) = np.eye(4), axis / np.linalg.norm(axis)
    if kind == "prismatic":
        matrix[:3, 3] = position * np.array((x, y, z))
    elif kind != "fixed":
        skew = np.array(((0, -z, y), (z, 0, -x), (-y, x, 0)))
        matrix[:3, :3] += np.sin(position) * skew + (1 - np.cos(position)) * skew @ skew
    return matrix


def compute_matrices(
    visual_joints: tuple[VisualJoint, ...], base: np.ndarray, joints: np.ndarray
) -> list[np.ndarray]:
    matrices = [make_matrix(base[:3], base[3:])]
    for joint, position in zip(visual_joints, joints, strict=True):
        origin = make_matrix(np.array(joint.origin.position), np.array(joint.origin.orientation))
        motion = make_motion(joint.kind, np.array(joint.axis), position)
        matrices.append(matrices[joint.parent] @ origin @ motion)
    return matrices


@given(visual_joints=trees(), data=st.data(), count=st.integers(1, 3))
def test_link_poses_equal_matrix_products(
    visual_joints: tuple[VisualJoint, ...], data: st.DataObject, count: int
) -> None:
    base = np.array(
        [[*data.draw(VECTORS), *from_rpy(*data.draw(TURNS))] for _ in range(count)], dtype=float
    )
    joints = np.array([[data.draw(RADIANS) for _ in visual_joints] for _ in range(count)])

    links = find_link_poses(visual_joints, base, joints)

    for entity in range(count):
        expected = compute_matrices(visual_joints, base[entity], joints[entity])
        for pose, matrix in zip(links, expected, strict=True):
            found = make_matrix(pose[entity, :3], pose[entity, 3:])
            np.testing.assert_allclose(found, matrix, atol=1e-9)


def test_wheel_rotates_about_its_axis() -> None:
    joint = VisualJoint("continuous", 0, Origin((0.0, 0.05, 0.0)), (0.0, 1.0, 0.0))

    _, wheel = find_link_poses((joint,), REST[None], np.array([[np.pi / 2.0]]))

    assert wheel[0, :3] == pytest.approx((0.0, 0.05, 0.0))
    assert wheel[0, 3:] == pytest.approx((0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)))


def test_pose_of_a_single_link_is_the_base_pose() -> None:
    (base,) = find_link_poses((), REST[None] + 1.0, np.zeros((1, 0)))

    assert base[:, :3].tolist() == [[1.0, 1.0, 1.0]]


def test_template_does_not_depend_on_names() -> None:
    assert make_template(make_robot("r1")) == make_template(make_robot("r2"))


def test_template_depends_on_colours() -> None:
    red = make_robot("r2", shape=msgspec.structs.replace(CUBE, rgba=(1.0, 0.0, 0.0, 1.0)))

    assert make_template(make_robot("r1")) != make_template(red)


def test_collisions_replace_missing_meshes() -> None:
    link = Link("base", collisions=(CUBE,), visuals=(Shape("mesh", mesh="body.dae"),))

    assert make_template(Model("bot", (link,))).links == ((CUBE,),)


def test_available_mesh_is_drawn() -> None:
    mesh = Shape("mesh", (1.0, 1.0, 1.0), mesh="sha")
    model = Model("bot", (Link("base", collisions=(CUBE,), visuals=(mesh, CUBE)),))

    assert make_template(model).links == ((CUBE,),)
    assert make_template(model, {"sha"}).links == ((mesh, CUBE),)


def test_link_with_collisions_only_is_invisible() -> None:
    links = Link("base", collisions=(CUBE,)), Link("arm", visuals=(CUBE,))
    joint = Joint("hinge", "revolute", "base", "arm", Origin())

    assert make_template(Model("bot", links, (joint,))).links == ((), (CUBE,))


@pytest.mark.parametrize(("is_static", "shown"), [(False, (CUBE,)), (True, ())])
def test_collisions_of_a_robot_without_any_visual_are_drawn(
    is_static: bool,  # noqa: FBT001
    shown: tuple[Shape, ...],
) -> None:
    model = Model("bot", (Link("base", collisions=(CUBE,)),), is_static=is_static)

    assert make_template(model).links == (shown,)


def test_ground_is_not_drawn() -> None:
    link = Link("base", visuals=(Shape("plane"), CUBE))

    assert make_template(Model("ground", (link,))).links == ((CUBE,),)


@pytest.mark.parametrize(
    "model",
    [
        Model("empty", ()),
        Model("loose", (Link("base"), Link("wheel"))),
        Model("swapped", (Link("base"), Link("wheel")), (Joint("j", "fixed", "wheel", "base"),)),
        Model("orphan", (Link("base"), Link("wheel")), (Joint("j", "fixed", "gone", "wheel"),)),
        Model("own_parent", (Link("base"), Link("arm")), (Joint("j", "fixed", "arm", "arm"),)),
    ],
    ids=lambda model: model.name,
)
def test_template_needs_a_tree(model: Model) -> None:
    with pytest.raises(NotATree, match=model.name):
        make_template(model)


LENGTHS = st.floats(0.01, 5.0)


def compute_volume(mesh: TriangleMesh) -> float:
    """Compute the volume; positive if faces are counter-clockwise from outside."""
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    return float(np.sum(a * np.cross(b, c)) / 6.0)


def count_open_edges(mesh: TriangleMesh) -> int:
    edges = Counter((int(face[i]), int(face[(i + 1) % 3])) for face in mesh.faces for i in range(3))
    return sum(edges[a, b] != 1 or edges[b, a] != 1 for a, b in edges)


@given(x=LENGTHS, y=LENGTHS, z=LENGTHS)
def test_box_has_its_volume_and_extents(x: float, y: float, z: float) -> None:
    mesh = make_box(x, y, z)

    assert compute_volume(mesh) == pytest.approx(x * y * z)
    assert np.ptp(mesh.vertices, axis=0) == pytest.approx((x, y, z))


@given(radius=LENGTHS, length=LENGTHS)
def test_cylinder_has_about_its_volume_along_z(radius: float, length: float) -> None:
    mesh = make_cylinder(radius, length)

    assert compute_volume(mesh) == pytest.approx(np.pi * radius**2 * length, rel=0.01)
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(length)


@given(radius=LENGTHS, length=st.one_of(st.just(0.0), LENGTHS))
def test_capsule_has_about_its_volume_and_length(radius: float, length: float) -> None:
    mesh = make_capsule(radius, length)

    exact = np.pi * radius**2 * (length + 4.0 / 3.0 * radius)
    assert compute_volume(mesh) == pytest.approx(exact, rel=0.03)
    assert np.ptp(mesh.vertices[:, 2]) == pytest.approx(length + 2.0 * radius)


@pytest.mark.parametrize(
    "mesh",
    [
        make_box(1.0, 2.0, 3.0),
        make_cylinder(0.5, 1.0),
        make_capsule(0.5, 1.0),
        make_capsule(0.5, 0.0),
    ],
    ids=["box", "cylinder", "capsule", "sphere"],
)
def test_mesh_is_closed(mesh: TriangleMesh) -> None:
    assert count_open_edges(mesh) == 0


@pytest.mark.parametrize("kind", ["plane", "mesh"])
def test_plane_and_mesh_are_refused(kind: str) -> None:
    with pytest.raises(ValueError, match=repr(kind)):
        make_shape_mesh(Shape(kind))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("kind", "extents"),
    [
        ("box", (0.4, 0.6, 0.2)),
        ("sphere", (0.8, 0.8, 0.8)),
        ("cylinder", (0.8, 0.8, 0.6)),
        ("capsule", (0.8, 0.8, 1.4)),
    ],
)
def test_shape_has_the_extents_of_its_size(kind: str, extents: tuple[float, float, float]) -> None:
    size = extents if kind == "box" else (0.4, 0.6, 0.0)

    mesh = make_shape_mesh(Shape(kind, size))  # type: ignore[arg-type]

    assert np.ptp(mesh.vertices, axis=0) == pytest.approx(extents)


def test_merged_meshes_keep_their_faces() -> None:
    both = merge_meshes((make_box(1.0, 1.0, 1.0), make_cylinder(0.5, 1.0)))

    assert compute_volume(both) == pytest.approx(
        compute_volume(make_box(1, 1, 1)) + compute_volume(make_cylinder(0.5, 1.0))
    )
    assert count_open_edges(both) == 0


def test_link_has_a_part_per_colour() -> None:
    parts = make_link_meshes((CUBE, Shape("sphere", (0.1, 0.0, 0.0)), CUBE))

    assert [part.rgba for part in parts] == [BLUE, DEFAULT_RGBA]
    assert compute_volume(parts[0].mesh) == pytest.approx(2 * 0.1**3)


def test_round_part_is_smooth() -> None:
    box_part, ball_part = make_link_meshes((CUBE, Shape("sphere", (0.1, 0.0, 0.0))))

    assert ball_part.is_smooth
    assert not box_part.is_smooth


def test_part_of_a_file_is_scaled_and_placed_at_its_origin() -> None:
    shape = Shape("mesh", (1.0, -2.0, 1.0), Origin((0.0, 0.0, 5.0)), mesh="sha")

    (part,) = make_link_meshes(
        (shape, Shape("box", (0.1, 0.1, 0.1))), {"sha": make_box(1.0, 1.0, 1.0)}
    )

    assert part.has_file
    assert np.ptp(part.mesh.vertices[:8], axis=0).tolist() == [1.0, 2.0, 1.0]
    assert compute_volume(part.mesh) == pytest.approx(2.0 + 0.1**3)  # not inside out


def test_part_is_placed_at_its_origin() -> None:
    turned = Origin((1.0, 0.0, 0.0), tuple(from_rpy(0.0, np.pi / 2.0, 0.0)))

    (part,) = make_link_meshes((Shape("cylinder", (0.1, 2.0, 0.0), turned),))

    assert part.mesh.vertices[:, 0].min() == pytest.approx(0.0)
    assert part.mesh.vertices[:, 0].max() == pytest.approx(2.0)


PNG = b"\x89PNG and more"
TEXTURED = Shape("mesh", (1.0, 1.0, -2.0), mesh="m", texture=Texture("i", "c"))


def a_textured_mesh() -> TriangleMesh:
    return make_textured_mesh(SQUARE, np.arange(12, dtype=np.float32).reshape(-1, 2), PNG)


def test_mesh_without_its_texture_is_drawn_plain() -> None:
    model = Model("m", (Link("base", visuals=(TEXTURED,)),))

    plain = make_template(model, {"m"}).links[0][0]
    textured = make_template(model, {find_mesh_name(TEXTURED)}).links[0][0]

    assert (plain.texture, textured) == (None, TEXTURED)
    assert make_template(model, ()).links[0] == ()


def test_shapes_with_different_images_are_separate() -> None:
    meshes = {"m": weld_triangles(SQUARE), find_mesh_name(TEXTURED): a_textured_mesh()}
    plain = msgspec.structs.replace(TEXTURED, texture=None)

    textured, grey = make_link_meshes((TEXTURED, plain, TEXTURED), meshes)

    assert (textured.mesh.image, textured.rgba) == (PNG, (1.0, 1.0, 1.0, 1.0))
    assert textured.mesh.coordinates is not None
    assert len(textured.mesh.coordinates) == len(textured.mesh.vertices) == 12
    assert (grey.mesh.image, grey.rgba) == (b"", DEFAULT_RGBA)


def test_lights_of_links_are_in_the_template() -> None:
    lamp = Light("lamp", "point")
    lit = Model("m", (Link("base", visuals=(CUBE,), lights=(lamp,)),))

    assert make_template(lit).lights == ((lamp,),)
    assert make_template(make_robot()).lights == ()
