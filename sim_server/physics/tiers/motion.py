"""How vehicles of one kind move for a step: motors, twists, rolling wheels, arcs. Pure arrays."""

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.tiers.rows import turned
from zensim.sim_server.physics.tiers.vehicle import Vehicle

HARDLY = 1e-300
"""Stands for no turn [rad], of which an arc has no radius."""


def ramped(now: FloatArray, wanted: FloatArray, most: FloatArray | float) -> FloatArray:
    """Bring numbers nearer to what is wanted, by so much at most."""
    return np.minimum(np.maximum(wanted, now - most), now + most)


def twists_by_steering(vehicle: Vehicle, speeds: FloatArray, angles: FloatArray) -> FloatArray:
    """Find root twists (3, n) of cars and tricycles, which turn about their unsteered axle.

    Args:
        vehicle: Of all of them.
        speeds: (n, k) of the driven wheels [rad/s].
        angles: (n, s) of the steering joints [rad].
    """
    ahead, turn = np.zeros(len(speeds)), np.zeros(len(speeds))
    for wheel in vehicle.wheels:
        if wheel.steering >= 0:
            x, y = _beside_axle(vehicle, wheel.place)
            sin, cos = np.sin(angles[:, wheel.steering]), np.cos(angles[:, wheel.steering])
            ahead += x * cos + y * sin
            turn += sin
    pulled, square = np.zeros(len(speeds)), np.full(len(speeds), 1e-12)
    for number, wheel in enumerate(vehicle.wheels[: speeds.shape[1]]):
        rim = _rims(vehicle, number, ahead, turn, angles)
        pulled += rim * speeds[:, number] * wheel.radius_m
        square += rim * rim
    share = pulled / square
    x, y = vehicle.axle
    spin = share * turn
    return np.stack([share * ahead + spin * y, -spin * x, spin])


def rolling_speeds(vehicle: Vehicle, twists: FloatArray, angles: FloatArray) -> FloatArray:
    """Find how fast wheels (n, w) turn [rad/s] that roll along with root twists (3, n).

    Those that are driven are left out: w counts the others.
    """
    turn = twists[2]
    ahead = twists[0] - turn * vehicle.axle[1]
    driven = len(vehicle.driven.joints)
    found = np.zeros((twists.shape[1], len(vehicle.wheels) - driven))
    for at, wheel in enumerate(vehicle.wheels[driven:]):
        rim = _rims(vehicle, driven + at, ahead, turn, angles)
        found[:, at] = rim / wheel.radius_m
    return found


def _rims(
    vehicle: Vehicle, number: int, ahead: FloatArray, turn: FloatArray, angles: FloatArray
) -> FloatArray:
    """Find how fast [m/s] rims go when the axle goes ahead and turns."""
    wheel = vehicle.wheels[number]
    x, y = _beside_axle(vehicle, wheel.place)
    forward, aside = ahead - turn * y, turn * x
    if wheel.steering >= 0:
        angle = angles[:, wheel.steering]
        forward = np.cos(angle) * forward + np.sin(angle) * aside
    return np.asarray(forward * wheel.ahead[0])


def _beside_axle(vehicle: Vehicle, place: tuple[float, float]) -> tuple[float, float]:
    return place[0] - vehicle.axle[0], place[1] - vehicle.axle[1]


def arcs(
    heading: tuple[FloatArray, FloatArray], twists: FloatArray, dt_s: FloatArray | float
) -> FloatArray:
    """Find the ways (3, n) in the world: x, y, yaw of who keeps a twist (3, n) for a time.

    Args:
        heading: Its cosines and sines (n,) at the beginning.
        twists: vx, vy [m/s] along the heading and to its left, wz [rad/s].
        dt_s: How long; (n,) or one for all.
    """
    turn = twists[2] * dt_s
    half = turn * 0.5
    half[half == 0.0] = HARDLY
    sin = np.sin(half)
    chord = sin / half * dt_s
    along, across = chord * np.cos(half), chord * sin
    ahead = twists[0] * along - twists[1] * across
    left = twists[0] * across + twists[1] * along
    return np.stack([*turned(ahead, left, heading), turn])
