"""Occupied cells are those that fixed shapes cover at the height of the map."""

import numpy as np
import numpy.typing as npt
import pytest

from tests.sim_server.scene.test_planar_casting import JOINTS, TRIANGLES, a_model, a_pose
from zensim.proto.messages.model_messages import Shape
from zensim.sim_server.scene.occupancy_grid import (
    FREE,
    OCCUPIED,
    GridFrame,
    GridTooLarge,
    plan_grid,
)
from zensim.sim_server.scene.scene import SceneLayout

BAND = (0.1, 0.5)


def draw(
    *placed: tuple[Shape, list[float]], resolution_m: float = 0.05
) -> tuple[GridFrame, npt.NDArray[np.int8]]:
    layout = SceneLayout([a_model(shape) for shape, _ in placed], lambda _: TRIANGLES)
    base = np.array([pose for _, pose in placed]).reshape(-1, 7)
    drawing = plan_grid(layout.place(base, JOINTS), np.arange(len(placed)), BAND, resolution_m)
    for _ in drawing.draw():
        pass
    return drawing.frame, drawing.cells


def find_extent(frame: GridFrame, cells: npt.NDArray[np.int8]) -> list[float]:
    """Find the least and greatest x and y of occupied cells [m]."""
    row, column = np.nonzero(cells == OCCUPIED)
    (x, y), side = frame.corner, frame.resolution_m
    return [
        float(x + column.min() * side),
        float(x + (column.max() + 1) * side),
        float(y + row.min() * side),
        float(y + (row.max() + 1) * side),
    ]


def test_box_is_filled_at_its_place() -> None:
    frame, cells = draw((Shape("box", (1.0, 2.0, 1.0)), a_pose(3.02, -1.02)))

    assert find_extent(frame, cells) == pytest.approx([2.5, 3.55, -2.05, 0.0], abs=1e-9)
    assert (cells == OCCUPIED).sum() == 21 * 41


@pytest.mark.parametrize("kind", ["cylinder", "sphere", "capsule"])
def test_round_shape_covers_a_disc(kind: str) -> None:
    shape = Shape(kind, (1.0, 2.0, 0.0))  # type: ignore[arg-type]

    frame, cells = draw((shape, a_pose(0.0, 0.0, 0.3)), resolution_m=0.02)

    assert (cells == OCCUPIED).sum() * 0.02**2 == pytest.approx(np.pi, rel=0.03)
    assert find_extent(frame, cells) == pytest.approx([-1.0, 1.0, -1.0, 1.0], abs=0.03)


def test_faces_of_a_mesh_are_drawn_wherever_they_lean() -> None:
    frame, cells = draw((Shape("mesh", (2.0, 2.0, 2.0), mesh="m"), a_pose(0.0, 0.0)))

    # At 0.1 m the hypotenuse is at x + y = 1.9, at 0.5 m at 1.5; the legs are upright.
    assert find_extent(frame, cells) == pytest.approx([0.0, 1.9, 0.0, 1.9], abs=0.051)
    row, column = np.nonzero(cells == OCCUPIED)
    x, y = (frame.corner + 0.05 * (np.stack([column, row], axis=1) + 0.5)).T
    on_slope = (x > 0.2) & (y > 0.2)
    assert (x + y)[on_slope].min() == pytest.approx(1.5, abs=0.08)
    assert (x + y)[on_slope].max() == pytest.approx(1.9, abs=0.08)


@pytest.mark.parametrize("z", [-0.5, 1.2])
def test_what_is_below_or_above_the_band_is_left_out(z: float) -> None:
    _, cells = draw((Shape("box", (1.0, 1.0, 1.0)), a_pose(0.0, 0.0, z)))

    assert (cells == FREE).all()


def test_wall_across_cells_has_no_gaps() -> None:
    _, cells = draw((Shape("box", (6.0, 0.01, 1.0)), a_pose(0.0, 0.0, 0.3, 0.0, 0.0, 0.3)))

    row, column = np.nonzero(cells == OCCUPIED)
    order = np.argsort(column, kind="stable")
    assert set(np.diff(np.unique(column)).tolist()) == {1}
    assert np.abs(np.diff(row[order])).max() <= 2


def test_map_of_nothing_is_free_floor_around_the_origin() -> None:
    frame, cells = draw(resolution_m=0.5)

    assert (frame.corner.tolist(), cells.shape) == ([-1.0, -1.0], (4, 4))
    assert (cells == FREE).all()


def test_map_of_too_many_cells_is_refused() -> None:
    with pytest.raises(GridTooLarge):
        draw((Shape("box", (1.0, 1.0, 1.0)), a_pose(1e6, 1e6)))
