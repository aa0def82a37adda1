"""Decodes drive states into the state of each robot and orders them by epoch and step."""

import math
import struct
from collections.abc import Sequence
from itertools import accumulate
from typing import Literal

import msgspec

from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import STATE_COLUMNS, DriveState
from zensim.proto.messages.standard_messages import Twist, Vector3

CLAIM_BYTES = 4


def unpack_claims(claims: bytes) -> tuple[int, ...]:
    """Unpack the claims of a drive state.

    Raises:
        MalformedPayload: They are not whole numbers of 4 bytes.
    """
    if len(claims) % CLAIM_BYTES:
        raise MalformedPayload(f"{len(claims)} bytes of claims; each has {CLAIM_BYTES}")
    return struct.unpack(f"<{len(claims) // CLAIM_BYTES}I", claims)


TWIST_COLUMNS = 3
"""Numbers of an ordered twist: forward, left, turn."""


def unpack_twists(twists: bytes, count: int) -> tuple[Twist | None, ...]:
    """Unpack the ordered twists of a drive state; None for a robot without one.

    Raises:
        MalformedPayload: Their number is not that of the claims.
    """
    if not twists:
        return (None,) * count
    if len(twists) != 8 * TWIST_COLUMNS * count:
        raise MalformedPayload(f"{len(twists)} bytes of twists for {count} claims")
    rows = struct.iter_unpack(f"<{TWIST_COLUMNS}d", twists)
    return tuple(
        None if math.isnan(forward) else Twist(Vector3(forward, left), Vector3(z=turn))
        for forward, left, turn in rows
    )


def is_repeated(state: DriveState, answered: DriveState) -> bool:
    """Whether a state only orders other twists than the one that was answered."""
    return state.order > 0 and (state.epoch, state.step, state.claims) == (
        answered.epoch,
        answered.step,
        answered.claims,
    )


class RobotState(msgspec.Struct, frozen=True, gc=False):
    """State of one robot at one step."""

    time_ns: int
    base: tuple[float, ...]
    """State of the root link, `STATE_COLUMNS` numbers."""
    positions: tuple[float, ...]
    """Positions of all joints, in the order of `Model.joints`."""
    velocities: tuple[float, ...]
    efforts: tuple[float, ...] = ()
    """Efforts of all joints; empty if the server does not report them."""


class DriveStateLayout:
    """Positions of each robot's numbers in a drive state."""

    def __init__(self, joint_counts: Sequence[int]) -> None:
        ends = tuple(accumulate(joint_counts))
        self._joints = tuple(
            slice(end - count, end) for end, count in zip(ends, joint_counts, strict=True)
        )
        # For a few robots half the cost of arrays that are converted to floats.
        self._base = struct.Struct(f"<{STATE_COLUMNS * len(joint_counts)}d")
        self._all_joints = struct.Struct(f"<{ends[-1] if ends else 0}d")

    def split(self, state: DriveState) -> list[RobotState]:
        """Split a drive state by robots.

        Raises:
            MalformedPayload: The count of numbers does not match the claims.
        """
        try:
            base = self._base.unpack(state.base)
            positions = self._all_joints.unpack(state.joint_positions)
            velocities = self._all_joints.unpack(state.joint_velocities)
            efforts = self._all_joints.unpack(state.joint_efforts) if state.joint_efforts else ()
        except struct.error as error:
            raise MalformedPayload(f"drive state does not fit its claims: {error}") from error
        return [
            RobotState(
                state.time_ns,
                base[row * STATE_COLUMNS : (row + 1) * STATE_COLUMNS],
                positions[joints],
                velocities[joints],
                efforts[joints],
            )
            for row, joints in enumerate(self._joints)
        ]


class StateOrder:
    """Order of drive states: time goes back only with a higher epoch."""

    def __init__(self) -> None:
        self._latest: tuple[int, int] | None = None

    def forget(self) -> None:
        """Accept any next state: another server has its own time."""
        self._latest = None

    def classify(self, epoch: int, step: int) -> Literal["next", "reset", "stale"]:
        """Compare a state with the one before."""
        latest = self._latest
        if latest is not None and (epoch, step) < latest:
            return "stale"
        self._latest = (epoch, step)
        return "reset" if latest is not None and epoch > latest[0] else "next"
