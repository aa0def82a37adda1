"""Names and poses of fleets."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.names import InvalidName
from zensim.spawner.spawn.spawn_poses import (
    LAYOUTS,
    FleetLayout,
    RobotPlacement,
    derive_prefix,
    make_fleet_layout,
)

layouts = st.sampled_from(LAYOUTS)


def test_row_goes_along_x() -> None:
    assert make_fleet_layout("r", 3, "row", 2.0) == [
        RobotPlacement("r0", 0.0, 0.0),
        RobotPlacement("r1", 2.0, 0.0),
        RobotPlacement("r2", 4.0, 0.0),
    ]


def test_grid_has_rows_of_about_the_square_root() -> None:
    places = make_fleet_layout("r", 5, "grid", 1.0)

    assert [(place.x, place.y) for place in places] == [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1)]


def test_circle_faces_outward() -> None:
    for place in make_fleet_layout("r", 7, "circle", 1.0):
        assert math.atan2(place.y, place.x) == pytest.approx(
            math.remainder(place.yaw, 2.0 * math.pi), abs=1e-9
        )


def test_circle_of_one_is_its_middle() -> None:
    assert make_fleet_layout("r", 1, "circle", 1.0) == [RobotPlacement("r0", 0.0, 0.0, 0.0)]


@given(st.integers(2, 200), layouts, st.floats(0.01, 100.0))
def test_neighbours_stand_the_spacing_apart(
    count: int, layout: FleetLayout, spacing_m: float
) -> None:
    places = make_fleet_layout("r", count, layout, spacing_m)

    nearest = min(
        math.dist((a.x, a.y), (b.x, b.y)) for i, a in enumerate(places) for b in places[:i]
    )
    assert nearest == pytest.approx(spacing_m, rel=1e-6)
    assert [place.name for place in places] == [f"r{i}" for i in range(count)]


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize(
    ("count", "spacing_m"), [(0, 1.0), (-1, 1.0), (3, 0.0), (3, -1.0), (3, math.nan), (3, math.inf)]
)
def test_fleet_is_refused_when_it_is_none(
    layout: FleetLayout, count: int, spacing_m: float
) -> None:
    with pytest.raises(ValueError, match="spacing"):
        make_fleet_layout("r", count, layout, spacing_m)


@pytest.mark.parametrize(
    ("model", "stem"),
    [
        ("box_bot", "box_bot"),
        ("box_bot.urdf", "box_bot"),
        ("/home/me/robots/box_bot.urdf.xacro", "box_bot"),
        ("../R2.d2", "R2"),
    ],
)
def test_name_stem_is_the_file_without_folder_and_ending(model: str, stem: str) -> None:
    assert derive_prefix(model) == stem


@pytest.mark.parametrize("model", ["", "a/", "9.urdf", "my robot.urdf", ".urdf"])
def test_name_stem_is_refused_when_it_is_no_name(model: str) -> None:
    with pytest.raises(InvalidName, match="prefix"):
        derive_prefix(model)
