"""Blueprints, their cache, and preparation of shapes."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st

from tests.engines import STEP_NS
from tests.models import a_body, a_box, a_box_bot, a_cart, a_state
from zensim.proto.messages.model_messages import (
    IDENTITY,
    Contact,
    Inertial,
    Joint,
    Link,
    Model,
    Origin,
    Shape,
    Vec3,
)
from zensim.proto.se3 import from_rpy, rotate
from zensim.sim_server.physics.blueprint import (
    DEFAULT_FRICTION,
    MAX_MESHES_PER_PART,
    BlueprintCache,
    find_principal_axes,
    make_blueprint,
    split_static_meshes,
)
from zensim.sim_server.physics.bullet.pybullet_engine import MAX_PARTS, PyBulletEngine
from zensim.sim_server.physics.engine import EngineRefused, FloatArray
from zensim.sim_server.physics.engine_config import EngineConfig

angles = st.floats(-3.0, 3.0)
moments = st.floats(1e-4, 10.0)


def matrix_of(turn: FloatArray) -> FloatArray:
    return np.asarray(rotate(turn, np.eye(3)).T)


def six_of(matrix: FloatArray) -> tuple[float, ...]:
    return tuple(matrix[i, j] for i, j in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)))


def a_ball(friction: float, radius_m: float = 0.1) -> Shape:
    return Shape("sphere", (radius_m, 0.0, 0.0), friction=friction)


def test_blueprint_has_a_part_for_each_link_in_the_order_of_joints() -> None:
    model = a_cart()

    blueprint = make_blueprint(model)

    parts = blueprint.parts[: len(model.links)]
    assert [part.joint for part in parts] == [None, *model.joints]
    assert [part.parent for part in parts] == [-1, 0, 0]
    assert [part.mass_kg for part in parts] == [2.0, 0.2, 0.2]


def test_blueprint_finds_parents_down_a_chain() -> None:
    links = tuple(Link(name, a_body()) for name in "abc")
    joints = (Joint("j", "revolute", "a", "b"), Joint("k", "revolute", "b", "c"))

    blueprint = make_blueprint(Model("chain", links, joints))

    assert [part.parent for part in blueprint.parts] == [-1, 0, 1]


def test_blueprint_gives_each_further_friction_a_massless_part() -> None:
    balls = (a_ball(1.0), a_ball(0.0, 0.2), a_ball(1.0, 0.3), a_ball(0.5), a_ball(0.0, 0.4))
    model = Model("m", (Link("base", a_body(), balls),))

    root, *skins = make_blueprint(model).parts

    assert root.shapes == (balls[0], balls[2])
    assert [surface.shapes for surface in skins] == [(balls[1], balls[4]), (balls[3],)]
    assert [part.friction for part in (root, *skins)] == [1.0, 0.0, 0.5]
    assert all((s.mass_kg, s.parent, s.joint) == (0.0, 0, None) for s in skins)


def test_blueprint_puts_further_surfaces_after_all_links() -> None:
    two = (a_ball(1.0), a_ball(0.0))
    links = (Link("a", a_body(), two), Link("b", a_body(), two))

    blueprint = make_blueprint(Model("m", links, (Joint("j", "revolute", "a", "b"),)))

    assert [part.parent for part in blueprint.parts] == [-1, 0, 0, 1]
    assert [part.joint is None for part in blueprint.parts] == [True, False, True, True]


def test_blueprint_of_a_link_without_collisions_has_no_shapes() -> None:
    (root,) = make_blueprint(Model("m", (Link("base", a_body()),))).parts

    assert (root.shapes, root.friction) == ((), DEFAULT_FRICTION)


def test_blueprint_of_box_bot_has_one_part_for_both_casters() -> None:
    blueprint = make_blueprint(a_box_bot())

    assert len(blueprint.parts) == 4
    assert [shape.friction for shape in blueprint.parts[3].shapes] == [0.0, 0.0]
    assert (blueprint.name, blueprint.is_static) == ("box_bot", False)


def test_principal_axes_are_those_of_the_link_when_products_are_zero() -> None:
    assert find_principal_axes((3.0, 0.0, 0.0, 1.0, 0.0, 2.0)) == ((3.0, 1.0, 2.0), IDENTITY)


@pytest.mark.parametrize("turn", [(0.0, 0.0, 0.5), (1.0, 0.0, 0.0), (3.1, 0.0, 0.0), (1.0, 2.0, 3)])
def test_principal_axes_give_the_inertia_back(turn: tuple[float, float, float]) -> None:
    axes = matrix_of(from_rpy(*turn))
    inertia = axes @ np.diag([1.0, 2.0, 2.5]) @ axes.T

    diagonal, principal = find_principal_axes(six_of(inertia))

    found = matrix_of(np.array(principal))
    assert found @ np.diag(diagonal) @ found.T == pytest.approx(inertia, abs=1e-12)


@given(st.tuples(moments, moments, moments), st.tuples(angles, angles, angles))
def test_principal_axes_are_a_proper_rotation(
    diagonal: tuple[float, float, float], turn: tuple[float, float, float]
) -> None:
    axes = matrix_of(from_rpy(*turn))
    inertia = axes @ np.diag(diagonal) @ axes.T

    found, principal = find_principal_axes(six_of(inertia))

    rotation = matrix_of(np.array(principal))
    assert np.linalg.norm(principal) == pytest.approx(1.0, abs=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0, abs=1e-9)
    assert rotation @ np.diag(found) @ rotation.T == pytest.approx(inertia, abs=1e-9)
    assert sorted(found) == pytest.approx(sorted(diagonal), rel=1e-9)


def test_blueprint_keeps_mass_centre_and_inertia() -> None:
    inertial = Inertial(3.0, (0.1, 0.2, 0.3), (1.0, 0.0, 0.0, 2.0, 0.0, 2.5))

    (root,) = make_blueprint(Model("m", (Link("base", inertial),))).parts

    assert (root.mass_kg, root.com, root.inertia) == (3.0, (0.1, 0.2, 0.3), (1.0, 2.0, 2.5))


def test_link_with_many_shapes_is_split() -> None:
    boxes = tuple(Shape("box", (1.0, 1.0, 1.0), Origin((float(i), 0.0, 0.0))) for i in range(40))

    parts = make_blueprint(Model("m", (Link("base", collisions=boxes),))).parts

    assert [len(part.shapes) for part in parts] == [16, 16, 8]
    assert [part.parent for part in parts] == [-1, 0, 0]


def test_blueprint_gives_each_further_contact_a_part() -> None:
    soft, hard = Shape("sphere", contact=Contact(1e4, 1.0)), Shape("sphere")
    model = Model("m", (Link("base", a_body(), (hard, soft)),))

    root, surface = make_blueprint(model).parts

    assert (root.contact, surface.contact) == (hard.contact, soft.contact)
    assert (root.link, surface.link) == (0, 0)


def a_rib(direction: Vec3, *, along: float = 1.0, across: float = 0.1) -> Shape:
    contact = Contact(direction=direction, friction_across=across)
    return Shape("sphere", friction=along, contact=contact)


@pytest.mark.parametrize("direction", [(0.8, 0.6, 0.0), (0.6, -0.8, 0.0), (0.0, 0.8, -0.6)])
def test_surface_has_a_principal_axis_along_its_friction_direction(direction: Vec3) -> None:
    rib = a_rib(direction)

    root, surface = make_blueprint(Model("m", (Link("base", a_body(), (rib,)),))).parts

    assert (root.shapes, surface.shapes) == ((), (rib,))
    assert rotate(np.array(surface.principal), np.array([1.0, 0.0, 0.0])) == pytest.approx(
        direction
    )


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, 1.0)])
def test_friction_direction_along_a_principal_axis_needs_no_surface(direction: Vec3) -> None:
    rib = a_rib(direction)

    (root,) = make_blueprint(Model("m", (Link("base", a_body(), (rib,)),))).parts

    assert (root.shapes, root.contact) == ((rib,), rib.contact)


@pytest.mark.parametrize(
    ("direction", "along_axle", "across_axle"),
    [((0.0, -1.0, 0.0), 3.0, 1.0), ((1.0, 0.0, 0.0), 1.0, 3.0), ((0.6, 0.8, 0.0), 3.0, 1.0)],
)
def test_friction_direction_of_a_turning_link_is_its_axle(
    direction: Vec3, along_axle: float, across_axle: float
) -> None:
    wheel = Link("wheel", a_body(), (a_rib(direction, along=3.0, across=1.0),))
    axle = Joint("j", "continuous", "base", "wheel", axis=(0.0, 1.0, 0.0))

    _, part = make_blueprint(Model("m", (Link("base", a_body()), wheel), (axle,))).parts

    assert part.contact.direction == (0.0, 1.0, 0.0)
    assert (part.friction, part.contact.friction_across) == (along_axle, across_axle)


def test_friction_direction_of_a_limited_link_turns_with_it() -> None:
    foot = Link("foot", a_body(), (a_rib((1.0, 0.0, 0.0)),))
    ankle = Joint("j", "revolute", "base", "foot", axis=(0.0, 1.0, 0.0), lower=-1.0, upper=1.0)

    _, part = make_blueprint(Model("m", (Link("base", a_body()), foot), (ankle,))).parts

    assert part.contact.direction == (1.0, 0.0, 0.0)


def a_cache(max_parts: int = 128) -> BlueprintCache:
    return BlueprintCache(
        "mine", max_parts=max_parts, joint_kinds=("fixed", "continuous"), shape_kinds=("box",)
    )


def test_blueprint_is_cached_for_the_last_model() -> None:
    cache, model = a_cache(), a_box()

    first = cache.find(model)

    assert first == make_blueprint(model)
    assert cache.find(model) is first


def test_another_model_has_another_blueprint() -> None:
    cache, box = a_cache(), a_box()
    cache.find(box)

    found = cache.find(Model("other", box.links))

    assert found.name == "other"


def test_unsupported_model_is_refused_each_time() -> None:
    cache, model = a_cache(max_parts=1), a_cart()

    for _ in range(2):
        with pytest.raises(EngineRefused):
            cache.find(model)


MESHES = 20


def a_scene(count: int = MESHES, *, boxes: int = 0, is_static: bool = True) -> Model:
    """Make a model of meshes, each a metre beside the one before it, and of boxes."""
    shapes = [
        Shape("mesh", (1.0, 1.0, 1.0), mesh=f"m{i}", friction=0.5 + i % 2) for i in range(count)
    ]
    shapes += [Shape("box", (1.0, 1.0, 1.0), friction=0.5)] * boxes
    return Model("scene", (Link("base", collisions=tuple(shapes)),), is_static=is_static)


@pytest.mark.parametrize("count", [1, 20, 126, 127, 500])
def test_static_meshes_are_distributed_over_available_parts(count: int) -> None:
    blueprint = make_blueprint(a_scene(count, boxes=3))

    found = split_static_meshes(blueprint, max_parts=MAX_PARTS)

    assert len(found.parts) <= MAX_PARTS
    sizes = [sum(bool(shape.mesh) for shape in part.shapes) for part in found.parts]
    assert max(sizes) <= max(MAX_MESHES_PER_PART, -(-count // 50))
    assert sum(sizes) == count
    assert sum(len(part.shapes) for part in found.parts) == count + 3
    for part in found.parts:
        assert {shape.friction for shape in part.shapes} <= {part.friction}


def test_moving_meshes_are_not_split() -> None:
    blueprint = make_blueprint(a_scene(is_static=False))

    assert split_static_meshes(blueprint, max_parts=MAX_PARTS) == blueprint


def test_shapes_are_prepared_one_part_at_a_time(tmp_path: Path) -> None:
    for number in range(MESHES):
        wall = trimesh.creation.box((0.1, 1.0, 1.0 + 0.01 * number))
        wall.apply_translation((number, 0.0, 0.5))
        tmp_path.joinpath(f"m{number}.stl").write_bytes(wall.export(file_type="stl"))
    engine = PyBulletEngine(EngineConfig(STEP_NS, mesh_folder=str(tmp_path)))

    parts = -(-MESHES // MAX_MESHES_PER_PART) + 1  # of two frictions
    turns = [engine.prepare(a_scene()) for _ in range(parts + 1)]
    engine.add(a_scene(), a_state((0.0, 0.0, 0.0)))
    on_top = [engine.add(a_box(), a_state((float(x), 0.0, 3.0))) for x in range(MESHES)]
    for _ in range(480):
        engine.step()

    heights = engine.read(on_top).base[:, 2]
    assert turns == [*[False] * parts, True]
    assert np.all(heights > 1.0)
    engine.close()


@pytest.mark.parametrize("shape", [Shape("mesh", mesh="a"), Shape("plane")], ids=lambda s: s.kind)
def test_errors_are_raised_by_add_and_not_by_prepare(tmp_path: Path, shape: Shape) -> None:
    engine = PyBulletEngine(EngineConfig(STEP_NS, mesh_folder=str(tmp_path)))

    assert engine.prepare(Model("m", (Link("base", collisions=(shape,)),), is_static=True))
    engine.close()
