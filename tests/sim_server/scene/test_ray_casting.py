"""Rays hit shapes where closed forms, triangles and PyBullet say."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pybullet
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st

from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.se3 import FloatArray, from_rpy
from zensim.sim_server.scene.ray_casting import GROUND, NO_ENTITY, RayHits
from zensim.sim_server.scene.scene import CollisionScene, SceneLayout

HERE = np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
NONE = np.zeros(0)
TETRAHEDRON = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
TRIANGLES = TETRAHEDRON[FACES].reshape(-1, 3)
BOX = Shape("box", (0.4, 0.8, 1.2))
SPHERE = Shape("sphere", (0.7, 0.0, 0.0))
CYLINDER = Shape("cylinder", (0.5, 1.6, 0.0))
CAPSULE = Shape("capsule", (0.4, 1.0, 0.0))
MESH = Shape("mesh", (1.0, 2.0, 1.5), mesh="tetrahedron")


def a_model(*shapes: Shape) -> Model:
    return Model("m", (Link("base", collisions=shapes),), is_static=True)


def a_scene(
    *models: Model, base: FloatArray | None = None, has_ground: bool = False
) -> CollisionScene:
    layout = SceneLayout(models, lambda _: TRIANGLES, has_ground=has_ground)
    return CollisionScene(
        layout, np.repeat(HERE, len(models), axis=0) if base is None else base, NONE
    )


def cast_one(
    scene: CollisionScene, origin: object, direction: object, max_range_m: float = 100.0
) -> RayHits:
    towards = np.array([direction], dtype=float)
    towards /= np.linalg.norm(towards)
    return scene.cast_rays(np.array([origin], dtype=float), towards, max_range_m)


@pytest.mark.parametrize(
    ("shape", "origin", "direction", "expected"),
    [
        (BOX, (-3.0, 0.1, 0.1), (1.0, 0.0, 0.0), 2.8),
        (BOX, (0.0, 0.0, 5.0), (0.0, 0.0, -1.0), 4.4),
        (BOX, (-3.0, 0.5, 0.0), (1.0, 0.0, 0.0), np.inf),
        (BOX, (0.1, 0.0, 0.0), (1.0, 0.0, 0.0), 0.1),
        (SPHERE, (-3.0, 0.0, 0.0), (1.0, 0.0, 0.0), 2.3),
        (SPHERE, (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 0.7),
        (SPHERE, (-3.0, 0.71, 0.0), (1.0, 0.0, 0.0), np.inf),
        (CYLINDER, (0.0, 0.3, 4.0), (0.0, 0.0, -1.0), 3.2),
        (CYLINDER, (0.0, 0.51, 4.0), (0.0, 0.0, -1.0), np.inf),
        (CYLINDER, (-3.0, 0.0, 0.79), (1.0, 0.0, 0.0), 2.5),
        (CYLINDER, (-3.0, 0.0, 0.81), (1.0, 0.0, 0.0), np.inf),
        (CAPSULE, (0.0, 0.0, 4.0), (0.0, 0.0, -1.0), 3.1),
        (CAPSULE, (-3.0, 0.0, 0.4), (1.0, 0.0, 0.0), 2.6),
        (CAPSULE, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), 0.9),
        (MESH, (0.1, 0.1, -2.0), (0.0, 0.0, 1.0), 2.0),
        (MESH, (0.1, 0.1, 9.0), (0.0, 0.0, -1.0), 9.0 - 1.5 * 0.85),
        (MESH, (5.0, 5.0, -2.0), (0.0, 0.0, 1.0), np.inf),
        (Shape("plane"), (3.0, 4.0, 2.0), (0.0, 0.0, -1.0), 2.0),
        (Shape("plane"), (0.0, 0.0, 1.0), (4.0, 0.0, -1.0), np.sqrt(17.0)),
        (Shape("plane"), (0.0, 0.0, 1.0), (1.0, 0.0, 0.0), np.inf),
    ],
)
def test_ray_hits_a_shape_at_the_distance_of_the_closed_form(
    shape: Shape, origin: object, direction: object, expected: float
) -> None:
    hits = cast_one(a_scene(a_model(shape)), origin, direction)

    assert hits.ranges[0] == pytest.approx(expected, abs=1e-12)
    assert hits.entities[0] == (NO_ENTITY if expected == np.inf else 0)


def triangulate(shape: Shape) -> FloatArray:
    """Approximate a shape by triangles (f, 3, 3)."""
    radius, length, _ = shape.size
    if shape.kind == "box":
        mesh = trimesh.creation.box(shape.size)
    elif shape.kind == "sphere":
        mesh = trimesh.creation.icosphere(subdivisions=3, radius=radius)
    elif shape.kind == "cylinder":
        mesh = trimesh.creation.cylinder(radius, length, sections=256)
    elif shape.kind == "capsule":
        mesh = trimesh.creation.capsule(length, radius, count=[48, 48])
    else:
        mesh = trimesh.Trimesh(TETRAHEDRON * shape.size, FACES)
    return np.asarray(mesh.triangles)


SOLIDS: dict[str, tuple[Shape, FloatArray, float]] = {
    shape.kind: (shape, triangulate(shape), error_m)
    for shape, error_m in [
        *((BOX, 1e-9), (SPHERE, 0.01), (CYLINDER, 0.01), (CAPSULE, 0.01), (MESH, 1e-9))
    ]
}


def rotation_matrix(roll: float, pitch: float, yaw: float) -> FloatArray:
    (sr, sp, sy), (cr, cp, cy) = np.sin([roll, pitch, yaw]), np.cos([roll, pitch, yaw])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, cr, -sr], [0.0, sr, cr]])
    about_y = np.array([[cp, 0.0, sp], [0.0, 1.0, 0.0], [-sp, 0.0, cp]])
    about_z = np.array([[cy, -sy, 0.0], [sy, cy, 0.0], [0.0, 0.0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)


def cast_at_triangles(triangles: FloatArray, origin: FloatArray, direction: FloatArray) -> float:
    """Cast by brute force: the plane of each triangle, and on which side of its edges it is hit."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    slope = normal @ direction
    at = np.einsum("ij,ij->i", normal, a - origin) / np.where(slope == 0.0, 1e-300, slope)
    is_hit = (at >= 0.0) & (at < 1e6)
    point = origin + np.where(is_hit, at, 0.0)[:, None] * direction
    for start, end in ((a, b), (b, c), (c, a)):
        is_hit &= np.einsum("ij,ij->i", np.cross(end - start, point - start), normal) >= 0.0
    return float(at[is_hit].min(initial=np.inf))


@pytest.mark.parametrize("kind", SOLIDS)
@settings(max_examples=8, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_rays_agree_with_brute_force_over_triangles(kind: str, seed: int) -> None:
    shape, triangles, error_m = SOLIDS[kind]
    rng = np.random.default_rng(seed)
    position, turn = rng.uniform(-1.0, 1.0, 3), rng.uniform(-3.0, 3.0, 3)
    placed = triangles @ rotation_matrix(*turn).T + position
    origins, directions = rng.uniform(-3.0, 3.0, (20, 3)), rng.normal(size=(20, 3))
    directions += position - origins
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    base = np.concatenate([position, from_rpy(*turn)])[None]

    found = a_scene(a_model(shape), base=base).cast_rays(origins, directions, 100.0).ranges

    shifts = np.vstack([np.zeros(3), 2.0 * error_m * np.eye(3), -2.0 * error_m * np.eye(3)])
    for i in range(20):
        near = [cast_at_triangles(placed, origins[i] + s, directions[i]) for s in shifts]
        # A ray that grazes the surface may hit only one of the shape and its triangles.
        if np.isfinite(near).all() and np.ptp(near) < 0.1:
            assert found[i] == pytest.approx(near[0], abs=np.ptp(near) + error_m + 1e-7)
        elif not np.isfinite(near).any():
            assert found[i] == np.inf


@contextmanager
def a_bullet_world() -> Iterator[int]:
    client = pybullet.connect(pybullet.DIRECT)
    try:
        yield client
    finally:
        pybullet.disconnect(client)


def make_bullet_shape(shape: Shape, client: int) -> int:
    radius, length, _ = shape.size
    if shape.kind == "box":
        half = [size / 2.0 for size in shape.size]
        return pybullet.createCollisionShape(
            pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client
        )
    if shape.kind == "mesh":
        vertices = (TETRAHEDRON * shape.size).tolist()
        return pybullet.createCollisionShape(
            pybullet.GEOM_MESH, vertices=vertices, physicsClientId=client
        )
    kinds = {"sphere": pybullet.GEOM_SPHERE, "cylinder": pybullet.GEOM_CYLINDER}
    return pybullet.createCollisionShape(
        kinds.get(shape.kind, pybullet.GEOM_CAPSULE),
        radius=radius,
        height=length,
        physicsClientId=client,
    )


@pytest.mark.parametrize("kind", SOLIDS)
def test_ray_from_outside_agrees_with_pybullet(kind: str) -> None:
    shape, rng = SOLIDS[kind][0], np.random.default_rng(1)
    position, turn = np.array([0.3, -0.2, 0.5]), from_rpy(0.4, -0.7, 1.1)
    origins = rng.normal(size=(400, 3))
    origins = position + 4.0 * origins / np.linalg.norm(origins, axis=1)[:, None]
    ends = position + rng.uniform(-0.8, 0.8, (400, 3))
    directions = ends - origins
    lengths = np.linalg.norm(directions, axis=1)
    with a_bullet_world() as client:
        body = make_bullet_shape(shape, client)
        pybullet.createMultiBody(
            0.0,
            body,
            basePosition=position.tolist(),
            baseOrientation=turn.tolist(),
            physicsClientId=client,
        )
        far = origins + 2.0 * directions
        expected = pybullet.rayTestBatch(origins.tolist(), far.tolist(), physicsClientId=client)
    scene = a_scene(a_model(shape), base=np.concatenate([position, turn])[None])

    found = scene.cast_rays(origins, directions / lengths[:, None], 100.0).ranges

    ranges = np.array([hit[2] for hit in expected]) * 2.0 * lengths
    is_hit = np.array([hit[0] >= 0 for hit in expected])
    both = is_hit & np.isfinite(found)
    # Bullet adds a collision margin and iterates, so rays that graze differ.
    assert (is_hit == np.isfinite(found)).mean() > 0.97
    assert np.median(np.abs(found[both] - ranges[both])) < 2e-3
    assert np.quantile(np.abs(found[both] - ranges[both]), 0.95) < 0.03


def test_ray_hits_the_nearest_of_many_entities() -> None:
    base = np.repeat(HERE, 5, axis=0)
    base[:, 0] = [9.0, 3.0, 6.0, 3.0, -2.0]

    hits = cast_one(a_scene(*[a_model(SPHERE)] * 5, base=base), (0.0, 0.0, 0.0), (1.0, 0.0, 0.0))

    assert (hits.ranges[0], hits.entities[0]) == (pytest.approx(2.3), 1)


def test_ray_hits_nothing_beyond_its_range() -> None:
    hits = cast_one(a_scene(a_model(SPHERE)), (-3.0, 0.0, 0.0), (1.0, 0.0, 0.0), max_range_m=2.29)

    assert (hits.ranges[0], hits.entities[0]) == (np.inf, NO_ENTITY)


def test_ray_passes_through_the_ignored_entity_and_hits_the_ground() -> None:
    scene = a_scene(a_model(SPHERE), has_ground=True)
    origins, down = np.array([[0.0, 0.0, 5.0]] * 2), np.array([[0.0, 0.0, -1.0]] * 2)

    hits = scene.cast_rays(origins, down, 100.0, np.array([NO_ENTITY, 0]))

    assert hits.ranges == pytest.approx([4.3, 5.0])
    assert hits.entities.tolist() == [0, GROUND]


def test_rays_into_an_empty_scene_hit_nothing() -> None:
    assert cast_one(a_scene(), (0.0, 0.0, 1.0), (0.0, 0.0, -1.0)).entities[0] == NO_ENTITY


def test_direction_must_be_a_unit_vector() -> None:
    with pytest.raises(ValueError, match=r"0\.5"):
        a_scene().cast_rays(np.zeros((1, 3)), np.array([[0.5, 0.0, 0.0]]), 1.0)


@settings(max_examples=5, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_many_rays_hit_what_each_hits_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    models = [a_model(shape) for shape in (BOX, SPHERE, CYLINDER, CAPSULE, MESH, BOX)]
    base = np.array([[*rng.uniform(-4, 4, 3), *from_rpy(*rng.uniform(-3, 3, 3))] for _ in models])
    scene = a_scene(*models, base=base, has_ground=True)
    origins, directions = rng.uniform(-4, 4, (20, 3)), rng.normal(size=(20, 3))
    directions /= np.linalg.norm(directions, axis=1)[:, None]

    hits = scene.cast_rays(origins, directions, 50.0)

    for i in range(20):
        alone = [
            cast_one(a_scene(model, base=base[[row]]), origins[i], directions[i], 50.0).ranges[0]
            for row, model in enumerate(models)
        ]
        alone.append(cast_one(a_scene(has_ground=True), origins[i], directions[i], 50.0).ranges[0])
        assert hits.ranges[i] == pytest.approx(min(alone))
