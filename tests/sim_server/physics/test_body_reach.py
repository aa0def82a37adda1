"""Bounds of models."""

import math
from pathlib import Path

import msgspec
import numpy as np
import pytest

from tests.models import TRACK_M, a_box, a_cart, a_fork, a_puck, an_arm
from zensim.proto.messages.model_messages import Link, Model, Origin, Shape
from zensim.proto.stl import write_corners
from zensim.sim_server.physics import body_reach
from zensim.sim_server.physics.body_reach import MAX_REACH_M, SHAPE_MARGIN_M, ReachCache
from zensim.sim_server.physics.engine import can_move


def radius(model: Model, folder: str = "") -> float:
    return ReachCache(folder).measure(model).radius_m - SHAPE_MARGIN_M


@pytest.mark.parametrize(
    ("shape", "expected"),
    [
        (Shape("box", (2.0, 2.0, 1.0)), 1.5),
        (Shape("sphere", (0.5, 0.0, 0.0)), 0.5),
        (Shape("cylinder", (3.0, 8.0, 0.0)), 5.0),
        (Shape("capsule", (1.0, 4.0, 0.0)), 3.0),
        (Shape("sphere", (0.5, 0.0, 0.0), Origin((3.0, 4.0, 0.0))), 5.5),
        (Shape("plane"), MAX_REACH_M - SHAPE_MARGIN_M),
    ],
    ids=lambda value: getattr(value, "kind", None),
)
def test_radius_encloses_a_shape(shape: Shape, expected: float) -> None:
    assert radius(Model("m", (Link("base", collisions=(shape,)),))) == pytest.approx(expected)


def test_radius_encloses_a_scaled_mesh(tmp_path: Path) -> None:
    corners = np.array([[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]])
    Path(tmp_path, "abc.stl").write_bytes(write_corners(corners))
    model = Model("m", (Link("base", collisions=(Shape("mesh", (1.0, 2.0, 1.0), mesh="abc"),)),))

    assert radius(model, str(tmp_path)) == pytest.approx(4.0)


def test_radius_encloses_wheels_and_casters() -> None:
    assert radius(a_cart()) >= max(TRACK_M / 2.0 + 0.05, math.hypot(0.125, 0.1))


def test_reach_lists_prismatic_joints() -> None:
    assert ReachCache("").measure(an_arm("prismatic")).slides == (0,)
    assert ReachCache("").measure(an_arm("revolute")).slides == ()


def test_levers_of_wheels_are_their_radii() -> None:
    levers = ReachCache("").measure(a_cart()).levers

    assert levers == pytest.approx([0.05, 0.05])


def test_levers_of_a_twist_are_one() -> None:
    ahead, left, _ = ReachCache("").measure(a_puck()).levers

    assert (ahead, left) == (1.0, 1.0)


def test_static_body_without_joints_cannot_move() -> None:
    assert not can_move(a_box(is_static=True))
    assert not can_move(msgspec.structs.replace(an_arm("fixed"), is_static=True))
    assert can_move(a_box())
    assert can_move(a_fork())


def test_prepare_measures_one_mesh_at_a_time(tmp_path: Path) -> None:
    corners = np.array([[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]]])
    for name in ("a", "b"):
        Path(tmp_path, f"{name}.stl").write_bytes(write_corners(corners))
    shapes = tuple(Shape("mesh", (1.0, 1.0, 1.0), mesh=name) for name in "aba")
    model, measure = Model("m", (Link("base", collisions=shapes),)), ReachCache(str(tmp_path))

    answers = [measure.prepare(model) for _ in range(3)]
    for file in tmp_path.iterdir():
        file.unlink()

    assert answers == [False, False, True]
    assert measure.measure(model).radius_m == pytest.approx(2.0 + SHAPE_MARGIN_M)


def test_prepare_skips_missing_meshes(tmp_path: Path) -> None:
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="gone")

    assert ReachCache(str(tmp_path)).prepare(Model("m", (Link("base", collisions=(shape,)),)))


def test_prepare_of_more_meshes_than_are_kept_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(body_reach, "MAX_CACHED_RADII", 2)
    monkeypatch.setattr(body_reach, "_MESH_RADII", {})
    corners = np.array([[[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0] * 3]])
    (tmp_path / "a.stl").write_bytes(write_corners(corners))
    shapes = [Shape("mesh", (scale, scale, scale), mesh="a") for scale in (1.0, 2.0, 3.0)]
    cache = ReachCache(str(tmp_path))

    model = Model("m", (Link("l", collisions=tuple(shapes)),), is_static=True)
    answers = [cache.prepare(model) for _ in range(4)]
    cache.measure(model)

    assert answers == [False, False, False, True]
    assert not cache.prepare(model)  # forgotten
