"""Static models become edges in the plane."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from tests.models import a_state
from zensim.proto.messages.model_messages import Link, Model, Origin, Shape
from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.kinematic.planar_vehicle import make_mesh_reader
from zensim.sim_server.scene.footprints import find_hull_edges, find_outline

NOWHERE = make_mesh_reader("")


def standing(shape: Shape) -> Model:
    return Model("post", (Link("base", collisions=(shape,)),), is_static=True)


def test_box_has_four_edges_of_its_height() -> None:
    box = standing(Shape("box", (2.0, 4.0, 1.0)))

    edges = find_outline(box, a_state((10.0, 0.0, 0.5), turn=(0.0, 0.0, np.pi / 2.0)), NOWHERE)

    lengths = np.hypot(*(edges.ends[:, 2:] - edges.ends[:, :2]).T)
    assert sorted(lengths) == pytest.approx([2.0, 2.0, 4.0, 4.0])
    assert edges.ends[:, :2].min(axis=0) == pytest.approx([8.0, -1.0])
    assert edges.heights == pytest.approx(np.tile([[0.0, 1.0]], (4, 1)))


def test_small_sphere_is_one_thick_point() -> None:
    edges = find_outline(
        standing(Shape("sphere", (0.2, 0.0, 0.0))), a_state((1.0, 2.0, 0.2)), NOWHERE
    )

    assert edges.ends.tolist() == [[1.0, 2.0, 1.0, 2.0]]
    assert edges.thick.tolist() == [0.2]


@pytest.mark.parametrize("kind", ["sphere", "capsule", "cylinder"])
def test_large_round_shape_is_a_polygon_about_it(kind: str) -> None:
    shape = Shape(kind, (2.0, 1.0, 0.0))  # type: ignore[arg-type]

    edges = find_outline(standing(shape), a_state(), NOWHERE)

    middles = (edges.ends[:, :2] + edges.ends[:, 2:]) / 2.0
    assert (np.hypot(*middles.T) >= 2.0 - 1e-9).all()
    assert (np.hypot(*edges.ends[:, :2].T) < 2.1).all()


def test_plane_has_no_edges() -> None:
    assert len(find_outline(standing(Shape("plane")), a_state(), NOWHERE)) == 0


def test_mesh_has_the_edges_of_each_triangle() -> None:
    triangle = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 2.0]])
    shape = Shape("mesh", (1.0, 1.0, 1.0), Origin((5.0, 0.0, 0.0)), mesh="a")

    edges = find_outline(standing(shape), a_state(), lambda _: triangle)

    assert len(edges) == 3
    assert edges.heights.tolist() == [[0.0, 2.0]] * 3
    assert edges.ends[:, 0].min() == 5.0


@settings(max_examples=80, deadline=None)
@given(arrays(np.float64, (12, 2), elements=st.floats(-5.0, 5.0).map(lambda x: round(x, 2))))
def test_hull_contains_all_points(flat: FloatArray) -> None:
    edges = find_hull_edges(flat)

    first, along = edges[:, :2], edges[:, 2:] - edges[:, :2]
    from_first = flat[None] - first[:, None]
    side = along[:, None, 0] * from_first[:, :, 1] - along[:, None, 1] * from_first[:, :, 0]
    assert (side >= -1e-9).all()
    assert edges[:, 2:] == pytest.approx(np.roll(edges[:, :2], -1, axis=0))
