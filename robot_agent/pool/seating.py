"""Where each robot of a pool stands in the arrays of drive states and commands."""

import struct
from collections.abc import Sequence

import numpy as np

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import STATE_COLUMNS, DriveState
from zensim.robot_agent.pool.rows import FloatArray
from zensim.robot_agent.pool.squad import PoolState, Seats

FLOAT_BYTES = 8


class Seating:
    """Robots in the order of a state's claims, and where their joints and targets begin."""

    def __init__(self, joint_counts: Sequence[int], target_counts: Sequence[int]) -> None:
        self._joints = np.concatenate([[0], np.cumsum(joint_counts)]).astype(np.int64)
        self._targets = np.concatenate([[0], np.cumsum(target_counts)]).astype(np.int64)

    @property
    def target_total(self) -> int:
        """How many numbers a command has."""
        return int(self._targets[-1])

    def of_squad(self, places: Sequence[int]) -> Seats:
        """Find the seats of robots that all have as many joints and targets."""
        at = np.array(places, dtype=np.int64)
        joints, targets = self._joints, self._targets
        return Seats(
            at,
            joints[at, None] + np.arange(joints[at[0] + 1] - joints[at[0]]),
            targets[at, None] + np.arange(targets[at[0] + 1] - targets[at[0]]),
        )

    def of_one(self, place: int) -> tuple[slice, slice]:
        """Find where the joints and the targets of one robot are."""
        joints, targets = self._joints[place : place + 2], self._targets[place : place + 2]
        return slice(*joints.tolist()), slice(*targets.tolist())

    def read(self, state: DriveState, twists: FloatArray) -> PoolState:
        """Lay a state out in arrays.

        Raises:
            MalformedPayload: It has not the numbers that its claims call for.
        """
        rows, joints = len(self._joints) - 1, int(self._joints[-1])
        return PoolState(
            state.time_ns,
            _floats(state.base, rows * STATE_COLUMNS).reshape(rows, STATE_COLUMNS),
            _floats(state.joint_positions, joints),
            _floats(state.joint_velocities, joints),
            twists,
        )


def claims_in(claims: bytes) -> list[int]:
    """Read the claims of a state.

    Raises:
        MalformedPayload: They are not whole numbers of 4 bytes.
    """
    if len(claims) % 4:
        raise MalformedPayload(f"{len(claims)} bytes of claims; each has 4")
    return list(struct.unpack(f"<{len(claims) // 4}I", claims))


def _floats(numbers: bytes, count: int) -> FloatArray:
    if len(numbers) != count * FLOAT_BYTES:
        raise MalformedPayload(
            f"drive state does not fit its claims: {len(numbers)} bytes for {count} numbers"
        )
    return np.frombuffer(numbers, dtype="<f8")
