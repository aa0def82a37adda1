"""Drives, odometry and base controllers of a group, in arrays with a row per robot."""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from zensim.proto.drives.array_math import ARRAY_MATH
from zensim.proto.drives.differential_drive import find_base_step, integrate_base_step
from zensim.proto.drives.drive_kinematics import make_drive_kinematics
from zensim.proto.drives.measured_joints import MeasuredJoints
from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.drive_messages import Drive, WheelPair
from zensim.proto.messages.model_messages import IDENTITY
from zensim.robot_agent.base_controller import find_motion_rates
from zensim.robot_agent.odometry import MotionColumns, find_encoder_motion, find_world_motion
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.robot_rows import (
    ALL_ROWS,
    NEW_ROW,
    BoolArray,
    FloatArray,
    GroupRateLimiter,
    IntArray,
    KeptRows,
    StateRows,
    remap_flags,
    remap_floats,
    take_rows,
)

MOTION_COLUMNS = 10
REST_MOTION = np.array([0.0, 0.0, 0.0, *IDENTITY, 0.0, 0.0, 0.0])
VX, VY, WZ = 0, 1, 5
"""Columns of a twist (n, 6)."""


def _stack_motion(rows: int, motion: MotionColumns[FloatArray]) -> FloatArray:
    """Write a motion as rows (n, MOTION_COLUMNS)."""
    position, orientation, *velocities = motion
    return _stack(rows, (*position, *orientation, *velocities))


def _stack(rows: int, columns: Iterable[FloatArray | float]) -> FloatArray:
    # Not numpy's stack: columns may be plain floats.
    columns = tuple(columns)
    found = np.empty((rows, len(columns)))
    for number, column in enumerate(columns):
        found[:, number] = column
    return found


class GroupEncoderOdometry:
    """See `zensim.robot_agent.odometry.EncoderOdometry`; a row per robot."""

    def __init__(self, pair: WheelPair, *, is_speed_unsigned: bool) -> None:
        self._pair = pair
        self._is_speed_unsigned = is_speed_unsigned
        self._has_before = np.zeros(0, dtype=np.bool_)
        self._before = np.zeros((0, 2))
        self._before_ns = np.zeros(0)
        self._pose = np.zeros((0, 3))
        self.motions = np.zeros((0, MOTION_COLUMNS))

    def remap(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        self._has_before = remap_flags(self._has_before, before)
        self._before = remap_floats(self._before, before)
        self._before_ns = remap_floats(self._before_ns, before)
        self._pose = remap_floats(self._pose, before)
        self.motions = remap_floats(self.motions, before)
        self.motions[before < 0] = REST_MOTION

    def reset(self) -> None:
        """Start at 0 again."""
        self._has_before[:] = False
        self._pose[:] = 0.0
        self.motions[:] = REST_MOTION

    def update(self, wheels_rad: FloatArray, time_ns: int) -> None:
        """Take the wheel joints' positions, left and right (n, 2), at a time of the simulation."""
        is_next = self._has_before & (self._before_ns < time_ns)
        rolled_rad = wheels_rad - self._before
        elapsed_s = (time_ns - self._before_ns) * 1e-9
        self._has_before[:] = True
        self._before[:] = wheels_rad
        self._before_ns[:] = time_ns
        if is_next.any():
            self._advance(is_next, rolled_rad[is_next], elapsed_s[is_next])

    def _advance(self, is_next: BoolArray, rolled_rad: FloatArray, elapsed_s: FloatArray) -> None:
        step = find_base_step(self._pair, rolled_rad[:, 0], rolled_rad[:, 1])
        x, y, yaw = self._pose[is_next].T
        pose = integrate_base_step((x, y, yaw), *step, ARRAY_MATH)
        self._pose[is_next] = _stack(len(x), pose)
        motion = find_encoder_motion(
            pose, step, elapsed_s, ARRAY_MATH, is_speed_unsigned=self._is_speed_unsigned
        )
        self.motions[is_next] = _stack_motion(len(x), motion)


class DriveUpdate(NamedTuple):
    """What an update of some rows began with."""

    rows: IntArray
    state: FloatArray
    positions: FloatArray
    velocities: FloatArray
    elapsed_s: FloatArray

    def join(self, later: "DriveUpdate") -> "DriveUpdate":
        """Add an update of other rows."""
        columns = [np.concatenate(pair) for pair in zip(self[1:], later[1:], strict=True)]
        return DriveUpdate(np.concatenate([self.rows, later.rows]), *columns)

    def remap(self, before: IntArray) -> "DriveUpdate":
        """Leave out rows that are gone, and number the others anew; see `remap_floats`."""
        is_kept = before != NEW_ROW
        after = np.full(max(self.rows.max(initial=-1), before.max(initial=-1)) + 1, NEW_ROW)
        after[before[is_kept]] = np.flatnonzero(is_kept)
        rows = after[self.rows]
        found = rows != NEW_ROW
        return DriveUpdate(rows[found], *(column[found] for column in self[1:]))


class GroupDrive:
    """Drive kinematics of a group and their state, (n, state_size)."""

    def __init__(self, drive: Drive) -> None:
        self._kinematics = make_drive_kinematics(drive, ARRAY_MATH)
        self._state = np.zeros((0, self._kinematics.state_size))
        self.longest_s = math.inf
        """Most time [s] that an update counts."""
        self._last: DriveUpdate | None = None
        self._last_ns = -1

    def remap(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        self._last = None if self._last is None else self._last.remap(before)
        self._state = remap_floats(self._state, before)

    def reset(self, rows: IntArray | slice = ALL_ROWS) -> None:
        """Set the state of rows to 0."""
        self._last = None
        self._state[rows] = 0.0

    def save(self) -> FloatArray:
        """Copy the state of all rows."""
        return np.array(self._state)

    def load(self, state: FloatArray) -> None:
        """Put back what `save` returned."""
        self._last = None
        self._state[:] = state

    def begin(self, time_ns: int) -> None:
        """Forget the updates of another time; robots claimed later add theirs to those of this."""
        if time_ns != self._last_ns:
            self._last, self._last_ns = None, time_ns

    def update(
        self,
        rows: IntArray,
        twists: FloatArray,
        *,
        positions: FloatArray,
        velocities: FloatArray,
        elapsed_s: FloatArray,
    ) -> FloatArray:
        """Find the targets of some rows, (m, target_count).

        Args:
            rows: (m,).
            twists: As commanded to the bases; (m, 6).
            positions: Of the joints of the actuators [rad]; (m, joints).
            velocities: [rad/s].
            elapsed_s: Simulation time since each row's last update; (m,).
        """
        update = DriveUpdate(rows, take_rows(self._state, rows), positions, velocities, elapsed_s)
        self._last = update if self._last is None else self._last.join(update)
        if len(rows) == len(self._state):
            # The update keeps the array of before.
            self._state = np.empty_like(self._state)
        return self._find_targets(twists, *update)

    def revise(self, twists: FloatArray) -> tuple[IntArray, FloatArray] | None:
        """Repeat the updates of the present time with other twists (n, 6) of all rows.

        Returns:
            Its rows (m,) and their targets; None if no row was updated.
        """
        if (last := self._last) is None:
            return None
        return last.rows, self._find_targets(twists[last.rows], *last)

    def _find_targets(
        self,
        twists: FloatArray,
        rows: IntArray,
        before: FloatArray,
        positions: FloatArray,
        velocities: FloatArray,
        elapsed_s: FloatArray,
    ) -> FloatArray:
        targets, state = self._kinematics.find_targets(
            (twists[:, VX], twists[:, VY], twists[:, WZ]),
            measured=MeasuredJoints(positions.T, velocities.T),
            state=tuple(before.T),
            dt_s=elapsed_s if self.longest_s == math.inf else elapsed_s.clip(max=self.longest_s),
        )
        if state:
            # Rows of joined updates are in any order.
            self._state[rows] = _stack(len(rows), state)
        return _stack(len(rows), targets)


class GroupBaseController:
    """Drives and odometry of a group, each at its own update rate."""

    def __init__(self, group_key: GroupKey) -> None:
        drive = group_key.drive
        self.targets = np.zeros((0, group_key.target_count))
        """Targets of `Model.drive_actuators`, a row per robot."""
        self._group_key = group_key
        self._measured = _find_span(group_key.measured)
        self._drive = GroupDrive(drive)
        self._least_s = 1.0 / drive.update_rate_hz if drive.update_rate_hz > 0.0 else 0.0
        self._limiters = GroupRateLimiter(drive.update_rate_hz)
        motion_hz = find_motion_rates(drive)[0]
        self._motion_limiter = None if motion_hz is None else GroupRateLimiter(motion_hz)
        self._encoders: GroupEncoderOdometry | None = None
        if (pair := drive.encoder) is not None:
            is_unsigned = drive.compat == "gazebo11"
            self._encoders = GroupEncoderOdometry(pair, is_speed_unsigned=is_unsigned)
        self._kept = KeptRows(STATE_COLUMNS if self._encoders is None else MOTION_COLUMNS)
        """State of the root link of each row, or its motion by encoders, at its last odometry."""
        self._motions: FloatArray | None = None
        """Motions of the kept states; None until a topic needs them."""

    def remap(self, before: IntArray) -> None:
        """Remap rows; see `remap_floats`."""
        self.targets = remap_floats(self.targets, before)
        self._kept.remap(before)
        self._motions = None
        for part in (self._drive, self._limiters, self._motion_limiter, self._encoders):
            if part is not None:
                part.remap(before)

    def reset(self) -> None:
        """Reset all; time may have gone back."""
        self.targets = np.zeros_like(self.targets)
        for part in (self._drive, self._limiters, self._motion_limiter, self._encoders):
            if part is not None:
                part.reset()

    @property
    def needs_all_states(self) -> bool:
        """Whether motions depend on each state."""
        return self._encoders is not None

    def limit_updates(self, longest_s: float) -> None:
        """Set the most time [s] that an update counts, at least that of the update rate."""
        self._drive.longest_s = max(longest_s, self._least_s)

    def update(self, state: StateRows, twists: FloatArray) -> IntArray:
        """Update targets and motions that are due.

        Args:
            state: Of all rows.
            twists: As commanded, (n, 6).

        Returns:
            Rows with a new motion.
        """
        time_ns, positions, velocities = state.time_ns, state.positions, state.velocities
        if self._encoders is not None and self._group_key.encoder is not None:
            self._encoders.update(positions[:, list(self._group_key.encoder)], time_ns)
        rows, elapsed_s = self._limiters.open(time_ns)
        self._drive.begin(time_ns)
        # Rows of before further robots were claimed at this time.
        self.revise(twists)
        if len(rows):
            found = self._drive.update(
                rows,
                take_rows(twists, rows),
                positions=take_rows(positions, rows)[:, self._measured],
                velocities=take_rows(velocities, rows)[:, self._measured],
                elapsed_s=elapsed_s,
            )
            if len(rows) == len(self.targets):
                self.targets = found
            else:
                self.targets[rows] = found
        if self._motion_limiter is not None:
            rows, _ = self._motion_limiter.open(time_ns)
        if len(rows):
            encoders = self._encoders
            self._kept.keep(rows, state.base if encoders is None else encoders.motions.copy())
            self._motions = None
        return rows

    def revise(self, twists: FloatArray) -> None:
        """Find the targets of this time's updates again, with other twists (n, 6)."""
        if (revised := self._drive.revise(twists)) is not None:
            rows, targets = revised
            self.targets[rows] = targets

    def find_motions(self, rows: IntArray) -> FloatArray:
        """Find the motions of some rows as of their last odometry, (m, MOTION_COLUMNS)."""
        if self._motions is None:
            self._motions = self._find_all_motions()
        return take_rows(self._motions, rows)

    def _find_all_motions(self) -> FloatArray:
        kept = self._kept.values
        if self._encoders is not None:
            return kept
        # Contiguous columns take a tenth less time.
        columns = tuple(np.ascontiguousarray(kept.T))
        motion = find_world_motion(columns, self._group_key.base_in_root, ARRAY_MATH)
        return _stack_motion(len(kept), motion)


def _find_span(places: tuple[int, ...]) -> slice | list[int]:
    """Find the slice of places that follow each other, which numpy reads without a copy."""
    if not places or list(places) != list(range(places[0], places[0] + len(places))):
        return list(places)
    return slice(places[0], places[0] + len(places))
