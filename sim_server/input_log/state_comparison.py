"""How far the states of a run are from recorded ones."""

from collections.abc import Sequence

import msgspec
import numpy as np
import numpy.typing as npt

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.sim_server.input_log.input_records import LoggedRoster, RecordedState
from zensim.sim_server.physics.engine import BodyStates, FloatArray
from zensim.sim_server.physics.engine_calls import read_floats

POSITION, QUATERNION, LINEAR, ANGULAR = slice(0, 3), slice(3, 7), slice(7, 10), slice(10, 13)
COLUMNS = 13


class StateDifference(msgspec.Struct, frozen=True, kw_only=True):
    """How far an entity is from where it was recorded."""

    entity: str
    position_m: float
    angle_rad: float
    speed_m_s: float
    turn_rate_rad_s: float
    joints: float
    """Greatest difference of a joint position [rad or m]."""
    is_equal: bool
    """Whether all bits are equal."""


class Distance(msgspec.Struct, frozen=True, kw_only=True):
    """How far trajectories have parted at a time."""

    time_s: float
    mean_m: float
    max_m: float
    max_rad: float
    entity: str
    """Entity with the greatest distance."""


def compare_states(
    states: BodyStates, present: Sequence[int], recorded: RecordedState, roster: LoggedRoster
) -> list[StateDifference]:
    """Compare states with recorded ones.

    Args:
        states: Of the entities that are present.
        present: Their places in the roster.
        recorded: States of all entities.
        roster: Names of all entities.
    """
    rows = np.array(present, dtype=np.intp)
    base = read_floats(recorded.base).reshape(-1, COLUMNS)[rows]
    greatest, moved = compare_joints(states, present, recorded, roster)
    figures = zip(
        np.linalg.norm(states.base[:, POSITION] - base[:, POSITION], axis=1).tolist(),
        find_angles(states.base[:, QUATERNION], base[:, QUATERNION]).tolist(),
        np.linalg.norm(states.base[:, LINEAR] - base[:, LINEAR], axis=1).tolist(),
        np.linalg.norm(states.base[:, ANGULAR] - base[:, ANGULAR], axis=1).tolist(),
        greatest.tolist(),
        ((states.base == base).all(axis=1) & ~moved).tolist(),
        strict=True,
    )
    return [
        StateDifference(
            entity=roster.names[place],
            position_m=metres,
            angle_rad=angle,
            speed_m_s=speed,
            turn_rate_rad_s=turn,
            joints=joint,
            is_equal=is_equal,
        )
        for place, (metres, angle, speed, turn, joint, is_equal) in zip(
            present, figures, strict=True
        )
    ]


def compare_joints(
    states: BodyStates, present: Sequence[int], recorded: RecordedState, roster: LoggedRoster
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Find the greatest difference of a joint of each entity, and whether any bit differs (n,).

    Joints of frozen entities are left out; see `compare_states`.
    """
    rows = np.array(present, dtype=np.intp)
    joints = np.concatenate([np.zeros(0, np.intp), *list_joints(roster, present)])
    positions = read_floats(recorded.positions)[joints]
    velocities = read_floats(recorded.velocities)[joints]
    owners = np.repeat(np.arange(len(rows)), np.array(roster.joint_counts, dtype=np.intp)[rows])
    is_left_out = np.isin(rows, np.array(roster.frozen, dtype=np.intp))[owners]
    apart = np.where(is_left_out, 0.0, np.abs(states.joint_positions - positions))
    is_moved = (apart != 0.0) | (~is_left_out & (states.joint_velocities != velocities))
    greatest, moved = np.zeros(len(rows)), np.zeros(len(rows), np.bool_)
    np.maximum.at(greatest, owners, apart)
    np.logical_or.at(moved, owners, is_moved)
    return greatest, moved


def list_joints(roster: LoggedRoster, present: Sequence[int]) -> list[npt.NDArray[np.intp]]:
    """List the joints of each entity that is present, by their places in recorded states."""
    ends = np.cumsum(roster.joint_counts, dtype=np.intp)
    return [np.arange(ends[place] - roster.joint_counts[place], ends[place]) for place in present]


def find_angles(ones: FloatArray, others: FloatArray) -> FloatArray:
    """Find the angles [rad] between orientations (n, 4), also very small ones."""
    signs = np.where((ones * others).sum(axis=1) < 0.0, -1.0, 1.0)
    chords = np.linalg.norm(ones - signs[:, None] * others, axis=1)
    return np.asarray(4.0 * np.arcsin(np.clip(chords / 2.0, 0.0, 1.0)))


def measure_distance(recorded: RecordedState, found: Sequence[StateDifference]) -> Distance | None:
    """Summarize how far entities are from where they were recorded; None without any."""
    if not found:
        return None
    metres = [one.position_m for one in found]
    farthest = max(found, key=lambda one: one.position_m)
    return Distance(
        time_s=recorded.time_ns / NANOSECONDS,
        mean_m=sum(metres) / len(metres),
        max_m=farthest.position_m,
        max_rad=max(one.angle_rad for one in found),
        entity=farthest.entity,
    )
