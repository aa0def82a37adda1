"""Fleets, frames and cameras of the page."""

import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.spawner.page.builders import (
    make_models,
    make_models_by_name,
    make_robot,
    make_snapshot,
    make_wall,
)
from zensim.proto.messages.model_messages import Light, Link, Model, Origin, Shape
from zensim.spawner.page.model_bounds import ModelBounds
from zensim.spawner.page.render_state import (
    MAX_MODEL_LIGHTS,
    MismatchedSnapshot,
    UnknownEntity,
    View,
    choose_view,
    fit_camera,
    format_state,
    make_fleet,
    make_frame,
)

COORDINATES = st.floats(-50.0, 50.0)
POINTS = st.lists(st.tuples(COORDINATES, COORDINATES, st.floats(0.0, 5.0)), min_size=1, max_size=20)


def test_equal_robots_are_one_group() -> None:
    fleet = make_fleet(("r1", "r2"), make_models(r1=make_robot("r1"), r2=make_robot("r2")))

    (group,) = fleet.groups
    assert group.names == ("r1", "r2")
    assert group.joint_columns.tolist() == [[0], [1]]
    assert fleet.joints == 2


def test_groups_keep_the_rows_of_their_entities() -> None:
    models = make_models(r1=make_robot(), w1=make_wall(), r2=make_robot(), w2=make_wall())

    fleet = make_fleet(("r1", "w1", "r2", "w2"), models)

    assert [group.rows.tolist() for group in fleet.groups] == [[0, 2], [1, 3]]
    assert fleet.robots == ("r1", "r2")
    assert fleet.rows == {"r1": 0, "w1": 1, "r2": 2, "w2": 3}


def test_fleet_needs_a_model_for_each_name() -> None:
    with pytest.raises(UnknownEntity, match="r2"):
        make_fleet(("r1", "r2"), make_models(r1=make_robot()))


def test_fleet_needs_the_model_of_an_entity() -> None:
    response = msgspec.structs.replace(make_models(r1=make_robot()), models=())

    with pytest.raises(UnknownEntity):
        make_fleet(("r1",), response)


def test_fleet_needs_models_that_are_trees() -> None:
    with pytest.raises(MismatchedSnapshot, match="loose"):
        make_fleet(("r1",), make_models(r1=Model("loose", (Link("a"), Link("b")))))


def test_empty_world_has_an_empty_frame() -> None:
    frame = make_frame(make_fleet((), make_models()), make_snapshot())

    assert frame.links == ()
    assert frame.base.shape == (0, 13)


def test_frame_has_the_poses_of_all_links() -> None:
    fleet = make_fleet(
        ("w1", "r1", "r2"), make_models(w1=make_wall(), r1=make_robot(), r2=make_robot())
    )

    frame = make_frame(fleet, make_snapshot("w1", "r1", "r2", joints=2))

    (wall,), (bases, wheels) = frame.links
    assert wall[:, :3].tolist() == [[0.0, 0.0, 0.0]]
    assert bases[:, :3].tolist() == [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]
    assert wheels[:, :3].tolist() == [[1.0, 0.05, 0.0], [2.0, 0.05, 0.0]]


@pytest.mark.parametrize(
    "change",
    [
        {"base": b""},
        {"base": np.full(13, np.nan).tobytes()},
        {"joint_positions": b"\0" * 24},
        {"joint_positions": np.array([np.inf]).tobytes()},
    ],
    ids=["no base", "nan", "too many joints", "infinite joint"],
)
def test_frame_refuses_arrays_of_another_size(change: dict[str, bytes]) -> None:
    fleet = make_fleet(("r1",), make_models(r1=make_robot()))
    snapshot = msgspec.structs.replace(make_snapshot("r1", joints=1), **change)

    with pytest.raises(MismatchedSnapshot, match=r"base|joint_positions"):
        make_frame(fleet, snapshot)


@given(points=POINTS, aspect=st.floats(0.5, 2.5), fov_rad=st.floats(0.4, 1.5))
def test_camera_sees_every_point(
    points: list[tuple[float, float, float]], aspect: float, fov_rad: float
) -> None:
    cloud = np.array(points)

    position, look_at = fit_camera(View(cloud), aspect=aspect, fov_rad=fov_rad)

    seen = np.abs(project(cloud, position, look_at)) / np.tan(fov_rad / 2.0)
    assert (seen <= (aspect, 1.0)).all()


@pytest.mark.parametrize(("aspect", "least", "most"), [(1.6, 0.6, 0.95), (390 / 844, 0.6, 0.95)])
@pytest.mark.parametrize("shape", ["row along x", "row along y", "grid"])
def test_first_camera_fills_the_width(shape: str, aspect: float, least: float, most: float) -> None:
    rows, columns = {"row along x": (10, 1), "row along y": (1, 10), "grid": (10, 10)}[shape]
    points = np.array([(float(x), float(y), 0.06) for x in range(rows) for y in range(columns)])

    position, look_at = fit_camera(View(points), aspect=aspect, fov_rad=0.785)

    across = project(points, position, look_at)[:, 0] / (np.tan(0.785 / 2.0) * aspect)
    assert least < (across.max() - across.min()) / 2.0 < most
    assert abs(across.max() + across.min()) < 0.05


def test_camera_of_a_single_robot_keeps_its_distance() -> None:
    position, look_at = fit_camera(View(np.zeros((1, 3))), aspect=1.6, fov_rad=0.785)

    assert 1.0 < np.linalg.norm(look_at - position) < 3.0
    assert look_at[2] == pytest.approx(0.0)


def project(points: np.ndarray, position: np.ndarray, look_at: np.ndarray) -> np.ndarray:
    """Project points (n, 3) of the world to (n, 2) at distance 1 of a camera, right and up."""
    ahead = (look_at - position) / np.linalg.norm(look_at - position)
    right = np.cross(ahead, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    seen: np.ndarray = (points - position) @ np.stack((right, np.cross(right, ahead), ahead)).T
    assert (seen[:, 2] > 0.0).all()
    flat: np.ndarray = seen[:, :2] / seen[:, 2:]
    return flat


def test_pose_is_formatted_in_metres_and_degrees() -> None:
    state = np.array((1.0, -2.0, 0.06, 0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5), 0.3, 0.4, 0, 0, 0, 1))

    assert format_state(state) == ("x 1.00  y -2.00  z 0.06 m", "90°", "0.50 m/s  1.00 rad/s")


def test_pose_and_speed_have_no_negative_zeros() -> None:
    state = np.full(13, -0.001)
    state[3:7] = (0.0, 0.0, -0.001, 1.0)

    assert format_state(state) == ("x 0.00  y 0.00  z 0.00 m", "0°", "0.00 m/s  0.00 rad/s")


def test_lights_of_links_move_with_them() -> None:
    lamp = Light("lamp", "spot", Origin((1.0, 0.0, 0.0)), direction=(1.0, 0.0, 0.0))
    model = Model("m", (Link("base", lights=(lamp,)),))
    fleet = make_fleet(("a", "b"), make_models(a=model, b=model))
    snapshot = make_snapshot("a", "b", at_x=5.0)
    base = np.frombuffer(snapshot.base).reshape(-1, 13).copy()
    base[1, 3:7] = (0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5))

    first, second = make_frame(fleet, msgspec.structs.replace(snapshot, base=base.tobytes())).lights

    assert first.origin.position == pytest.approx((6.0, 0.0, 0.0))
    assert second.origin.position == pytest.approx((6.0, 1.0, 0.0))
    assert second.direction == pytest.approx((0.0, 1.0, 0.0))


def test_number_of_lights_of_links_is_limited() -> None:
    model = Model("m", (Link("base", lights=(Light("lamp", "point"),)),))
    names = tuple(f"r{number}" for number in range(20))
    fleet = make_fleet(names, make_models_by_name(dict.fromkeys(names, model)))

    assert len(make_frame(fleet, make_snapshot(*names)).lights) == MAX_MODEL_LIGHTS


def view_of(low: tuple[float, ...], high: tuple[float, ...], **entities: Model) -> View:
    """Choose a view of entities whose models all have these bounds."""
    fleet = make_fleet(tuple(entities), make_models_by_name(entities))
    frame = make_frame(fleet, make_snapshot(*entities, joints=fleet.joints))
    return choose_view(fleet, frame, lambda _: ModelBounds(np.array((low, high))))


def test_view_shows_the_robots_only() -> None:
    slab = Shape("box", (18.0, 18.0, 0.1), Origin((0.0, 0.0, -0.05)))
    floor = Model("floor", (Link("base", visuals=(slab,)),))

    view = view_of((-9.0, -9.0, -0.1), (9.0, 9.0, 0.0), floor=floor, r1=make_robot())

    assert view.points.mean(axis=0).tolist() == pytest.approx([1.0, 0.0, -0.05])
    assert len(view.points) == 8
    assert view.elevation_rad < 0.5


def test_view_over_walls_is_from_above() -> None:
    view = view_of((-1.0, -1.0, 0.0), (1.0, 1.0, 2.0), wall=make_wall(), r1=make_robot())

    assert view.elevation_rad > 0.7


@pytest.mark.parametrize(("distance", "degrees"), [(3.0, 42.0), (7.0, 20.0)])
def test_view_shows_walls_behind_robots_unless_they_may_hide_them(
    distance: float, degrees: float
) -> None:
    wall = Shape("box", (0.2, 4.0, 2.0), Origin((distance, 0.0, 1.0)))
    hall = Model("hall", (Link("base", visuals=(wall,)),))

    view = view_of((-20.0, -20.0, 0.0), (20.0, 20.0, 2.0), hall=hall, r1=make_robot())

    assert np.degrees(view.elevation_rad) == pytest.approx(degrees)


def test_view_without_robots_shows_the_world() -> None:
    view = view_of((-1.0, -1.0, 0.0), (1.0, 1.0, 2.0), a=make_wall(), b=make_wall())

    assert view.points.tolist() == [[-1, -1, 0], [1, 1, 2], [0, -1, 0], [2, 1, 2]]


def test_view_of_a_floor_shows_it() -> None:
    assert len(view_of((-1.0, -1.0, 0.0), (1.0, 1.0, 0.0), a=make_wall()).points) == 2
