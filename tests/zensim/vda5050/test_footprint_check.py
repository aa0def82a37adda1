"""Free way of vehicles before boxes."""

import math

import numpy as np
import pytest

from zensim.proto.messages.entity_messages import Bounds, BoundsType
from zensim.proto.messages.standard_messages import Vector3
from zensim.vda5050.footprint_check import Box, find_free_way, make_box

VEHICLE = Box(half_length=0.4, half_width=0.3)


def look(
    other: tuple[float, float, float, float],
    box: Box,
    *,
    direction: float = 0.0,
    own: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0),
    reach: float = 3.0,
) -> float:
    places = np.array([own, other])
    boxes = np.array([VEHICLE, box])
    return float(find_free_way(places, boxes, np.array([0]), np.array([[direction, reach]]))[0])


@pytest.mark.parametrize(
    ("other", "expected"),
    [
        ((2.0, 0.0, 0.0, 0.0), 1.2),
        ((2.0, 0.5, 0.0, 0.0), 1.2),
        ((2.0, 0.7, 0.0, 0.0), math.inf),
        ((-2.0, 0.0, 0.0, 0.0), math.inf),
        ((5.0, 0.0, 0.0, 0.0), math.inf),
        ((2.0, 0.0, 3.0, 0.0), math.inf),
        ((2.0, 0.0, 0.0, math.pi / 2), 1.3),
    ],
)
def test_way_ends_at_a_box_in_the_lane(
    other: tuple[float, float, float, float], expected: float
) -> None:
    assert look(other, VEHICLE) == pytest.approx(expected)


def test_way_ends_at_a_long_wall_and_not_beside_a_slanted_one() -> None:
    wall = Box(half_length=10.0, half_width=0.1)

    assert look((1.5, 0.0, 0.0, math.pi / 2), wall) == pytest.approx(1.0)
    assert look((0.0, 3.0, 0.0, 0.2), wall) == math.inf


def test_way_is_free_inside_a_building_and_over_low_things() -> None:
    assert look((0.0, 0.0, 0.0, 0.0), Box(half_length=20.0, half_width=20.0)) == math.inf
    assert look((2.0, 0.0, 0.0, 0.0), VEHICLE._replace(top=0.01)) == math.inf


def test_vehicle_looks_where_it_moves() -> None:
    assert look((0.0, 2.0, 0.0, 0.0), VEHICLE, direction=math.pi / 2) == pytest.approx(1.4)
    assert look((-2.0, 0.0, 0.0, 0.0), VEHICLE, direction=math.pi) == pytest.approx(1.2)


def test_bounds_of_every_kind_become_boxes() -> None:
    corners = (Vector3(-1.0, -0.5, 0.0), Vector3(3.0, 0.5, 2.0))

    assert make_box(Bounds()) is None
    assert make_box(Bounds(BoundsType.BOX, corners)) == Box(1.0, 0.0, 2.0, 0.5, 0.0, 2.0)
    sphere = Bounds(BoundsType.SPHERE, (Vector3(1.0, 0.0, 0.5), Vector3(0.5, 0.0, 0.0)))
    assert make_box(sphere) == Box(1.0, 0.0, 0.5, 0.5, 0.0, 1.0)
