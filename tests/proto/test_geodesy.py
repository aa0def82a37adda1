"""Geodetic positions of points in a world."""

import numpy as np
import pytest

from zensim.proto.geodesy import WorldGeodesy, from_earth_centred, to_earth_centred
from zensim.proto.messages.sensing_messages import SphericalCoordinates

MUNICH = SphericalCoordinates(48.137, 11.575, 520.0)
PLACES = [
    MUNICH,
    SphericalCoordinates(),
    SphericalCoordinates(-33.9, 151.2, 30.0, heading_deg=137.0),
    SphericalCoordinates(89.9, -170.0, 0.0, heading_deg=-90.0),
]


def points_within(radius_m: float) -> np.ndarray:
    random = np.random.default_rng(3)
    points = random.uniform(-1.0, 1.0, (1000, 3)) * radius_m
    points[:, 2] *= 0.01
    return points


def to_geodetic(place: SphericalCoordinates, points: np.ndarray) -> np.ndarray:
    geodesy = WorldGeodesy(place)
    return geodesy.to_geodetic(geodesy.to_east_north_up(points))


def from_geodetic(place: SphericalCoordinates, geodetic: np.ndarray) -> np.ndarray:
    """Find points of the world by rotations of the earth-centred axes."""
    origin = np.array([[place.latitude_deg, place.longitude_deg, place.elevation_m]])
    away = to_earth_centred(geodetic) - to_earth_centred(origin)
    around, up = np.radians(place.longitude_deg), np.radians(90.0 - place.latitude_deg)
    x, y, z = away.T
    south, east = x * np.cos(around) + y * np.sin(around), y * np.cos(around) - x * np.sin(around)
    south, height = south * np.cos(up) - z * np.sin(up), south * np.sin(up) + z * np.cos(up)
    cos, sin = np.cos(np.radians(place.heading_deg)), np.sin(np.radians(place.heading_deg))
    return np.stack([cos * east - sin * south, -sin * east - cos * south, height], axis=1)


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize("radius_m", [10.0, 1000.0, 100_000.0])
def test_points_are_found_again_within_a_micrometre(
    place: SphericalCoordinates, radius_m: float
) -> None:
    points = points_within(radius_m)

    found = from_geodetic(place, to_geodetic(place, points))

    assert np.abs(found - points).max() < 1e-6


@pytest.mark.parametrize("place", PLACES)
def test_the_origin_is_at_the_place_of_the_world(place: SphericalCoordinates) -> None:
    (found,) = to_geodetic(place, np.zeros((1, 3)))

    assert found[:2] == pytest.approx([place.latitude_deg, place.longitude_deg], abs=1e-12)
    assert found[2] == pytest.approx(place.elevation_m, abs=1e-8)


def test_x_is_east_and_y_is_north_with_heading_zero() -> None:
    east, north, up = to_geodetic(MUNICH, np.eye(3) * 100.0)

    assert east[1] > MUNICH.longitude_deg + 1e-4
    assert east[0] == pytest.approx(MUNICH.latitude_deg, abs=1e-8)
    assert north[0] > MUNICH.latitude_deg + 1e-4
    assert north[1] == pytest.approx(MUNICH.longitude_deg, abs=1e-12)
    assert up == pytest.approx([MUNICH.latitude_deg, MUNICH.longitude_deg, 620.0])


def test_heading_turns_the_world_counter_clockwise_from_east() -> None:
    turned = SphericalCoordinates(48.137, 11.575, 520.0, heading_deg=90.0)

    x, y = WorldGeodesy(turned).to_east_north_up(np.eye(3)[:2])

    assert x == pytest.approx([0.0, 1.0, 0.0], abs=1e-15)
    assert y == pytest.approx([-1.0, 0.0, 0.0], abs=1e-15)


def test_a_degree_of_latitude_has_the_length_of_the_ellipsoid() -> None:
    """Source: a meridian arc of WGS84 from 45 to 46 degrees is 111 141.5 m."""
    arc = np.stack([np.linspace(45.0, 46.0, 2001), np.zeros(2001), np.zeros(2001)], axis=1)

    points = to_earth_centred(arc)

    length_m = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
    assert length_m == pytest.approx(111_141.5, abs=0.2)


def test_known_points_have_their_earth_centred_coordinates() -> None:
    """Source: semi-axes of WGS84."""
    known = np.array([[0.0, 0.0, 0.0], [0.0, 90.0, 100.0], [90.0, 0.0, 0.0], [-90.0, 0.0, 5.0]])
    centred = np.array(
        [[6378137.0, 0, 0], [0, 6378237.0, 0], [0, 0, 6356752.314245], [0, 0, -6356757.314245]]
    )

    assert to_earth_centred(known) == pytest.approx(centred, abs=1e-6)
    found = from_earth_centred(centred)
    assert found[:, 0] == pytest.approx(known[:, 0], abs=1e-12)
    assert found[:, 2] == pytest.approx(known[:, 2], abs=1e-6)
