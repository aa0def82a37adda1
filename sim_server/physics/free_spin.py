"""Spin of loose bodies: the torque that keeps their angular momentum and energy in a step.

Engines take the gyroscopic torque at the start of a step, or linearly: in PyBullet a body at 20
rad/s doubles its energy in 5 s, in MuJoCo its nutation dies away. The angular velocity of an engine
is that of the middle of the last step, by which the body turned. That of the next one is the
solution of the implicit midpoint rule, found by repetition (ADR 129).
"""

import numpy as np

from zensim.proto.messages.model_messages import Vec3
from zensim.proto.se3 import FloatArray, from_axis_angle, rotate
from zensim.sim_server.physics.engine import BoolArray

MIN_TURN_RAD = 0.005
"""Angle in a step from which the torque is computed."""
REPETITIONS = 5
"""Leaves 1e-5 of the energy at 20 rad/s and 240 Hz, 2e-4 at 40 rad/s."""
EQUAL_RATIO = 1.0 + 1e-6
"""Ratio of moments up to which there is no gyroscopic torque."""


def can_precess(moments: Vec3) -> bool:
    """Whether a body with these principal moments has a gyroscopic torque."""
    return max(moments) > EQUAL_RATIO * min(moments)


def find_spinning(spins: FloatArray, dt_s: float) -> BoolArray:
    """Find which angular velocities (n, 3) turn enough in a step."""
    return np.asarray(_find_squares(spins) > (MIN_TURN_RAD / dt_s) ** 2)


def _find_squares(vectors: FloatArray) -> FloatArray:
    x, y, z = vectors.T
    return np.asarray(x * x + y * y + z * z)


def find_next_spins(moments: FloatArray, spins: FloatArray, dt_s: float) -> FloatArray:
    """Find the angular velocities after a step without outer torques.

    Args:
        moments: (n, 3) principal.
        spins: (n, 3) in the principal axes [rad/s]; not 0.
        dt_s: Length of a step.
    """
    momenta = _turn_back(moments * spins, spins, dt_s)
    following = spins
    for _ in range(REPETITIONS):
        following = _turn_back(momenta, following, dt_s) / moments
    return following


def _turn_back(vectors: FloatArray, spins: FloatArray, dt_s: float) -> FloatArray:
    """Turn vectors (n, 3) against half a step of spins."""
    rates = np.sqrt(_find_squares(spins))
    return rotate(from_axis_angle(spins / rates[:, None], -rates * dt_s / 2.0), vectors)


def find_explicit_torques(moments: FloatArray, spins: FloatArray, dt_s: float) -> FloatArray:
    """Find the torques (n, 3), in the principal axes, for an engine with explicit Euler steps.

    See `find_next_spins`.
    """
    change = find_next_spins(moments, spins, dt_s) - spins
    return np.asarray(moments * change / dt_s + np.cross(spins, moments * spins))


def find_implicit_torques(moments: FloatArray, spins: FloatArray, dt_s: float) -> FloatArray:
    """Find the same for one that adds the derivative of the gyroscopic torque to its inertia."""
    change = find_next_spins(moments, spins, dt_s) - spins
    gyroscopic = np.cross(change, moments * spins) + np.cross(spins, moments * change)
    own = np.cross(spins, moments * spins)
    return np.asarray(moments * change / dt_s + gyroscopic + own)
