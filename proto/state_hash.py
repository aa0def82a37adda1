"""The hash of the states of all entities, as servers, clients and logs compute it."""

from collections.abc import Iterable
from hashlib import sha256


def hash_states(time_ns: int, names: Iterable[str], base: bytes, joint_positions: bytes) -> str:
    """Hash time, names, poses, velocities and joint positions, as hexadecimal digits.

    Args:
        time_ns: Simulation time.
        names: Of the entities, in the order of the states.
        base: Rows of 13 float64: position, quaternion, linear and angular velocity.
        joint_positions: float64, entity by entity.
    """
    parts = (time_ns.to_bytes(8, "little"), "\0".join(names).encode())
    return sha256(b"\0".join((*parts, base, joint_positions))).hexdigest()
