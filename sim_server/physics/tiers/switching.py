"""When a robot may leave full dynamics, and whether it stands as one that is driven flat. Pure."""

import numpy as np

from zensim.sim_server.physics.engine import FloatArray
from zensim.sim_server.physics.tiers.vehicle import Vehicle

SETTLED_S = 0.3
"""For how long a robot has been alone and even before it leaves full dynamics."""
LEVEL = 0.01
"""Most of the x and y of a quaternion that stands upright."""
ON_GROUND_M = 0.01
"""How far from the ground the lowest point may be."""
STEADY_M_S, STEADY_RAD_S = 0.03, 0.15
"""How far twists may differ from what the wheels say."""
RISING_M_S, ROCKING_RAD_S = 0.005, 0.05
"""How fast it may still rise, sink and rock."""
REACHED_M_S = 0.05
"""How far rims may be from the speed that is asked for."""


def stands_flat(base: FloatArray, low: float) -> bool:
    """Whether a root link at `base` stands upright on the ground, its lowest point at `low`."""
    is_level = bool((np.abs(base[3:5]) < LEVEL).all())
    return is_level and abs(float(base[2]) + low) < ON_GROUND_M


def goes_flat(base: FloatArray, twist: FloatArray) -> bool:
    """Whether a root link moves as a twist (3,) along its heading says."""
    ahead, left = _along_heading(base)
    return bool(
        abs(ahead - twist[0]) < STEADY_M_S
        and abs(left - twist[1]) < STEADY_M_S
        and abs(float(base[9])) < RISING_M_S
        and abs(float(base[12]) - twist[2]) < STEADY_RAD_S
        and (np.abs(base[10:12]) < ROCKING_RAD_S).all()
    )


def has_reached(vehicle: Vehicle, told: FloatArray, velocities: FloatArray) -> bool:
    """Whether wheels turn as told, and nothing else moves."""
    driven = list(vehicle.driven.joints)
    radii = np.array([wheel.radius_m for wheel in vehicle.wheels[: len(driven)]])
    missing = (told[list(vehicle.driven.places)] - velocities[driven]) * radii
    wheels = {wheel.joint for wheel in vehicle.wheels}
    others = [joint for joint in range(vehicle.joint_count) if joint not in wheels]
    return bool(
        (np.abs(missing) < REACHED_M_S).all() and (np.abs(velocities[others]) < STEADY_RAD_S).all()
    )


def _along_heading(base: FloatArray) -> tuple[float, float]:
    x, y, z, w = base[3:7].tolist()
    yaw = np.arctan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))
    vx, vy = base[7:9].tolist()
    return vx * np.cos(yaw) + vy * np.sin(yaw), vy * np.cos(yaw) - vx * np.sin(yaw)
