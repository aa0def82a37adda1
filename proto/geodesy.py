"""Geodetic positions (WGS84) of points in a world, on numpy arrays."""

import numpy as np
import numpy.typing as npt

from zensim.proto.messages.sensing_messages import SphericalCoordinates

FloatArray = npt.NDArray[np.float64]

EQUATOR_RADIUS_M = 6_378_137.0
FLATTENING = 1.0 / 298.257223563
"""Source: NIMA TR8350.2, WGS84."""
POLE_RADIUS_M = EQUATOR_RADIUS_M * (1.0 - FLATTENING)
ECCENTRICITY_2 = FLATTENING * (2.0 - FLATTENING)
"""Square of the first eccentricity."""
SECOND_ECCENTRICITY_2 = ECCENTRICITY_2 / (1.0 - ECCENTRICITY_2)
BOWRING_ROUNDS = 2
"""Leave 4e-9 m up to 100 km above the ellipsoid."""


class WorldGeodesy:
    """The geodetic place of a world: directions east, north, up, and positions on the ellipsoid."""

    def __init__(self, place: SphericalCoordinates) -> None:
        """Take the place of the world's origin, and the heading of its x axis."""
        latitude, longitude = np.radians([place.latitude_deg, place.longitude_deg])
        heading = np.radians(place.heading_deg)
        sin_lat, cos_lat = np.sin(latitude), np.cos(latitude)
        sin_lon, cos_lon = np.sin(longitude), np.cos(longitude)
        cos, sin = np.cos(heading), np.sin(heading)
        self._east_from_world = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
        self._earth_from_east = np.array(
            [
                [-sin_lon, -sin_lat * cos_lon, cos_lat * cos_lon],
                [cos_lon, -sin_lat * sin_lon, cos_lat * sin_lon],
                [0.0, cos_lat, sin_lat],
            ]
        )
        origin = np.array([[place.latitude_deg, place.longitude_deg, place.elevation_m]])
        self._origin = to_earth_centred(origin)[0]

    def to_east_north_up(self, vectors: FloatArray) -> FloatArray:
        """Express vectors (n, 3) of the world along east, north and up of its origin."""
        return np.asarray(vectors @ self._east_from_world.T)

    def to_geodetic(self, east_north_up: FloatArray) -> FloatArray:
        """Find latitude [deg], longitude [deg] and altitude [m] (n, 3) of points.

        Args:
            east_north_up: From the world's origin [m], (n, 3).
        """
        return from_earth_centred(self._origin + east_north_up @ self._earth_from_east.T)


def to_earth_centred(geodetic: FloatArray) -> FloatArray:
    """Convert latitude [deg], longitude [deg], altitude [m] to earth-centred axes [m]; (n, 3)."""
    latitude, longitude = np.radians(geodetic[:, 0]), np.radians(geodetic[:, 1])
    altitude, sine = geodetic[:, 2], np.sin(latitude)
    normal_m = EQUATOR_RADIUS_M / np.sqrt(1.0 - ECCENTRICITY_2 * sine**2)
    across_m = (normal_m + altitude) * np.cos(latitude)
    along_m = (normal_m * (1.0 - ECCENTRICITY_2) + altitude) * sine
    columns = (across_m * np.cos(longitude), across_m * np.sin(longitude), along_m)
    return np.stack(columns, axis=1)


def from_earth_centred(points: FloatArray) -> FloatArray:
    """Convert earth-centred points [m] to latitude, longitude [deg], altitude [m]; (n, 3).

    Source: Bowring, Survey Review 181 (1976); the altitude holds at the poles, too.
    """
    x, y, along_m = points.T
    across_m = np.hypot(x, y)
    reduced = np.arctan2(along_m * EQUATOR_RADIUS_M, across_m * POLE_RADIUS_M)
    for _ in range(BOWRING_ROUNDS):
        latitude = np.arctan2(
            along_m + SECOND_ECCENTRICITY_2 * POLE_RADIUS_M * np.sin(reduced) ** 3,
            across_m - ECCENTRICITY_2 * EQUATOR_RADIUS_M * np.cos(reduced) ** 3,
        )
        reduced = np.arctan2(POLE_RADIUS_M * np.sin(latitude), EQUATOR_RADIUS_M * np.cos(latitude))
    sine = np.sin(latitude)
    surface_m = EQUATOR_RADIUS_M * np.sqrt(1.0 - ECCENTRICITY_2 * sine**2)
    altitude_m = across_m * np.cos(latitude) + along_m * sine - surface_m
    return np.stack([np.degrees(latitude), np.degrees(np.arctan2(y, x)), altitude_m], axis=1)
