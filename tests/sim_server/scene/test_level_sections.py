"""Level planes cut boxes and meshes where trimesh cuts them, at every height."""

import numpy as np
import pytest
import trimesh

from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.se3 import FloatArray, from_rpy, to_matrix
from zensim.sim_server.scene.level_sections import SectionEdges, bound_shapes, find_sections
from zensim.sim_server.scene.scene import SceneLayout

SIZE = (0.4, 0.8, 1.2)
BOX = Shape("box", SIZE)
MESH = Shape("mesh", (1.0, 1.0, 1.0), mesh="box")
EVERYWHERE = (-np.inf, np.inf)
SOLID = trimesh.creation.box(SIZE)


def slice_shape(shape: Shape, pose: FloatArray, band: tuple[float, float]) -> SectionEdges:
    model = Model("m", (Link("base", collisions=(shape,)),))
    layout = SceneLayout([model], lambda _: SOLID.triangles.reshape(-1, 3))
    return find_sections(layout.place(pose[None], np.zeros(0)), np.array([0]), band)


def cut(edges: SectionEdges, height: float) -> FloatArray:
    is_cut = (edges.low <= height) & (height <= edges.high)
    return edges.take(np.flatnonzero(is_cut)).cut_at(np.array(height))


def find_area(ends: FloatArray) -> float:
    """Find the area enclosed by edges with the inside on their left."""
    (ax, ay), (bx, by) = ends[:, 0].T, ends[:, 1].T
    return float((ax * by - ay * bx).sum() / 2.0)


@pytest.mark.parametrize(
    "rpy", [(0.0, 0.0, 0.4), (0.01, 0.0, 1.0), (0.3, -0.7, 2.0), (1.0, 1.2, 0.1), (0.0, 1e-9, 0.0)]
)
@pytest.mark.parametrize("height", [-0.53, -0.2, 0.1, 0.31, 0.58])
def test_edges_of_a_box_enclose_the_section_of_its_mesh(
    rpy: tuple[float, float, float], height: float
) -> None:
    pose = np.array([0.3, -0.2, 0.05, *from_rpy(*rpy)])
    placed = np.eye(4)
    placed[:3, :3], placed[:3, 3] = to_matrix(pose[3:]), pose[:3]
    solid = SOLID.copy().apply_transform(placed)
    section = solid.section(plane_origin=[0.0, 0.0, height], plane_normal=[0.0, 0.0, 1.0])
    flat = None if section is None else section.to_2D(normal=[0.0, 0.0, 1.0])[0]

    ends = cut(slice_shape(BOX, pose, EVERYWHERE), height)

    assert find_area(ends) == pytest.approx(0.0 if flat is None else flat.area, abs=1e-9)


def test_mesh_has_an_edge_for_either_side_of_each_face() -> None:
    pose = np.array([0.0, 0.0, 0.0, *from_rpy(0.2, 0.1, 0.5)])

    ends = cut(slice_shape(MESH, pose, EVERYWHERE), 0.1)

    sides = {tuple(np.round(edge.reshape(-1), 9).tolist()) for edge in ends}
    assert len(sides) == len(ends)
    assert {(c, d, a, b) for a, b, c, d in sides} == sides


@pytest.mark.parametrize("shape", [BOX, MESH])
def test_band_has_all_edges_of_its_heights_and_no_others(shape: Shape) -> None:
    pose = np.array([0.0, 0.0, 0.0, *from_rpy(0.4, 0.3, 0.5)])
    everything = slice_shape(shape, pose, EVERYWHERE)

    band = slice_shape(shape, pose, (0.1, 0.2))

    assert len(band) < len(everything)
    assert band.high.min() >= 0.1
    assert band.low.max() <= 0.2
    for height in (0.1, 0.15, 0.2):
        assert np.array_equal(cut(band, height), cut(everything, height))


@pytest.mark.parametrize(
    ("shape", "extents", "radius"),
    [
        (Shape("sphere", (0.5, 0.0, 0.0)), (0.5, 0.5, 0.5), 0.5),
        (Shape("cylinder", (0.5, 2.0, 0.0)), (1.0, 0.5, 0.5), 1.5),
        (Shape("capsule", (0.5, 2.0, 0.0)), (1.5, 0.5, 0.5), 1.5),
        (Shape("box", (1.0, 2.0, 4.0)), (2.0, 1.0, 0.5), np.hypot(2.0, 1.0)),
        (Shape("plane"), (np.inf, np.inf, np.inf), np.inf),
    ],
)
def test_bounds_of_a_shape_that_lies_on_its_side(
    shape: Shape, extents: tuple[float, ...], radius: float
) -> None:
    model = Model("m", (Link("base", collisions=(shape,)),))
    pose = np.array([[1.0, 2.0, 3.0, *from_rpy(0.0, np.pi / 2.0, 0.0)]])
    placed = SceneLayout([model], lambda _: np.zeros((0, 3))).place(pose, np.zeros(0))

    bounds = bound_shapes(placed, np.array([0]))

    assert bounds.centres[0] == pytest.approx([1.0, 2.0, 3.0])
    assert bounds.extents[0] == pytest.approx(extents)
    assert bounds.radii[0] == pytest.approx(radius)
