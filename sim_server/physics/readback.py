"""Bodies read back: the engine gives tuples, one body after another; arrays come of them."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from zensim.sim_server.physics.engine import FloatArray

Triple = tuple[float, float, float]
Quadruple = tuple[float, float, float, float]
PlaceOf = Callable[[int, int], tuple[Triple, Quadruple]]
VelocityOf = Callable[[int, int], tuple[Triple, Triple]]
JointsOf = Callable[
    [int, Sequence[int], int], Iterable[tuple[float, float, Sequence[float], float]]
]


def base_states(
    bodies: Iterable[int], client: int, place_of: PlaceOf, velocity_of: VelocityOf
) -> FloatArray:
    """Read (n, 13): position, quaternion xyzw, linear and angular velocity of each."""
    # One long list: rows of their own, and arguments by name, cost a third more.
    numbers: list[float] = []
    for body in bodies:
        place, turn = place_of(body, client)
        linear, angular = velocity_of(body, client)
        numbers += place
        numbers += turn
        numbers += linear
        numbers += angular
    return np.array(numbers, dtype=np.float64).reshape(-1, 13)


def joint_states(
    bodies: Iterable[tuple[int, Sequence[int]]], client: int, joints_of: JointsOf
) -> tuple[FloatArray, FloatArray]:
    """Read positions (k,) and velocities (k,) of all joints named, body by body."""
    positions: list[float] = []
    velocities: list[float] = []
    for body, joints in bodies:
        for position, velocity, _, _ in joints_of(body, joints, client):
            positions.append(position)
            velocities.append(velocity)
    return np.array(positions, dtype=np.float64), np.array(velocities, dtype=np.float64)
