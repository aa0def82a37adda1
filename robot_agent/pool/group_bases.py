"""Drive controllers, odometry and base controllers of a group in arrays."""

import math
from typing import Protocol

import numpy as np

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    Limits,
    PlanarMove,
    TricycleDrive,
    WheelPair,
)
from zensim.proto.messages.model_messages import IDENTITY, Origin
from zensim.proto.rotation import multiply, rotate, to_yaw
from zensim.robot_agent.base_controller import find_motion_rates
from zensim.robot_agent.drives.ackermann_steering import MAX_STEER_RAD
from zensim.robot_agent.drives.differential_drive import (
    MAX_LEAD_M_S,
    MAX_RIM_SPEED_M_S,
    NO_LIMITS,
    REACHED_M_S,
)
from zensim.robot_agent.drives.planar_motion import MAX_PLANAR_SPEED
from zensim.robot_agent.drives.tricycle_steering import MAX_WHEEL_SPEED
from zensim.robot_agent.pool.group_key import GroupKey
from zensim.robot_agent.pool.robot_rows import (
    BoolArray,
    FloatArray,
    GroupRateLimiter,
    IntArray,
    remap_flags,
    remap_floats,
)

MOTION_COLUMNS = 10
REST_MOTION = np.array([0.0, 0.0, 0.0, *IDENTITY, 0.0, 0.0, 0.0])


def find_world_motions(base: FloatArray, base_in_root: Origin) -> FloatArray:
    """Read true motions: poses are in the world, velocities turned by their yaw.

    Args:
        base: States of root links, (n, STATE_COLUMNS).
        base_in_root: Where the bases are fixed on the root links.
    """
    root = base[:, 3:7]
    arm = rotate(root, np.array(base_in_root.position))
    orientation = multiply(root, np.array(base_in_root.orientation))
    # A point that is off the root link moves also because the link turns.
    vx = base[:, 7] + (base[:, 11] * arm[:, 2] - base[:, 12] * arm[:, 1])
    vy = base[:, 8] + (base[:, 12] * arm[:, 0] - base[:, 10] * arm[:, 2])
    yaw = to_yaw(orientation)
    cos, sin = np.cos(yaw), np.sin(yaw)
    found = np.empty((len(base), MOTION_COLUMNS))
    found[:, :3] = base[:, :3] + arm
    found[:, 3:7] = orientation
    found[:, 7] = cos * vx + sin * vy
    found[:, 8] = cos * vy - sin * vx
    found[:, 9] = base[:, 12]
    return found


class GroupEncoderOdometry:
    """See `zensim.robot_agent.odometry.EncoderOdometry`; a row a robot."""

    def __init__(self, pair: WheelPair, *, is_speed_unsigned: bool) -> None:
        self._pair = pair
        self._is_speed_unsigned = is_speed_unsigned
        self._has_before = np.zeros(0, dtype=np.bool_)
        self._before = np.zeros((0, 2))
        self._before_ns = np.zeros(0)
        self._pose = np.zeros((0, 3))
        self.motions = np.zeros((0, MOTION_COLUMNS))

    def remap(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
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
        """Take the wheel joints' positions, left and right (n, 2), at a moment of time."""
        is_next = self._has_before & (self._before_ns < time_ns)
        elapsed_s = np.where(is_next, (time_ns - self._before_ns) * 1e-9, 1.0)
        rolled_m = (wheels_rad - self._before) * (self._pair.diameter_m / 2.0)
        self._has_before[:] = True
        self._before[:] = wheels_rad
        self._before_ns[:] = time_ns
        if is_next.any():
            self._advance(is_next, rolled_m[is_next], elapsed_s[is_next])

    def _advance(self, is_next: BoolArray, rolled_m: FloatArray, elapsed_s: FloatArray) -> None:
        distance_m = (rolled_m[:, 0] + rolled_m[:, 1]) / 2.0
        turned_rad = (rolled_m[:, 1] - rolled_m[:, 0]) / self._pair.separation_m
        pose = self._pose[is_next]
        middle = pose[:, 2] + turned_rad / 2.0
        pose[:, 0] += distance_m * np.cos(middle)
        pose[:, 1] += distance_m * np.sin(middle)
        pose[:, 2] += turned_rad
        self._pose[is_next] = pose
        speed = distance_m / elapsed_s
        motions = np.zeros((len(pose), MOTION_COLUMNS))
        motions[:, :2] = pose[:, :2]
        motions[:, 5], motions[:, 6] = np.sin(pose[:, 2] / 2.0), np.cos(pose[:, 2] / 2.0)
        motions[:, 7] = np.abs(speed) if self._is_speed_unsigned else speed
        motions[:, 9] = turned_rad / elapsed_s
        self.motions[is_next] = motions


VX, VY, WZ = 0, 1, 5
"""Columns of a twist (n, 6)."""


class GroupDriveController(Protocol):
    """Finds what the actuators of many robots are to do."""

    def remap(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""

    def reset(self) -> None:
        """Forget what was told before."""

    def update(
        self,
        rows: IntArray,
        twists: FloatArray,
        *,
        positions: FloatArray,
        velocities: FloatArray,
        elapsed_s: FloatArray,
    ) -> FloatArray:
        """Find the numbers for the actuators of some rows, (m, target_count).

        Args:
            rows: Which robots; (m,).
            twists: As commanded to the bases; (m, 6).
            positions: Of the joints of the actuators [rad], as they are; (m, joints).
            velocities: [rad/s].
            elapsed_s: Simulation time since each row's last update; (m,).
        """


def make_group_drive_controller(drive: Drive) -> GroupDriveController:
    """Make the controllers of robots with this drive."""
    match drive:
        case DiffDrive():
            return GroupDifferentialDrive(drive)
        case AckermannDrive():
            return GroupAckermannSteering(drive)
        case TricycleDrive():
            return GroupTricycleSteering(drive)
        case PlanarMove():
            return GroupPlanarMotion()


class GroupVelocityLimiter:
    """See `drives.twist_limits.LimitedVelocity`."""

    def __init__(self, limits: Limits) -> None:
        self._limits = limits
        self._now = np.zeros(0)

    def remap(self, before: IntArray) -> None:
        """See `GroupDriveController`."""
        self._now = remap_floats(self._now, before)

    def reset(self) -> None:
        """See `GroupDriveController`."""
        self._now[:] = 0.0

    def update(self, rows: IntArray, wanted: FloatArray, elapsed_s: FloatArray) -> FloatArray:
        """Find the velocities (m,) after so much simulation time."""
        limits = self._limits
        if limits == NO_LIMITS:
            return wanted
        found = _clamp_rows_between(wanted, limits.min_velocity, limits.max_velocity)
        now = self._now[rows]
        if limits.max_acceleration is not None:
            found = np.minimum(found, now + limits.max_acceleration * elapsed_s)
        if limits.min_acceleration is not None:
            found = np.maximum(found, now + limits.min_acceleration * elapsed_s)
        self._now[rows] = found
        return found


class GroupDifferentialDrive:
    """See `drives.diff_drive.DifferentialDrive`."""

    def __init__(self, parameters: DiffDrive) -> None:
        pairs = parameters.pairs
        self._radii = np.array([pair.diameter_m / 2.0 for pair in pairs for _ in range(2)])
        self._separations = np.array([pair.separation_m for pair in pairs])
        self._max_acceleration = parameters.max_acceleration
        self._instructed = np.zeros((0, 2 * len(pairs)))
        self._linear = GroupVelocityLimiter(parameters.linear_limits)
        self._angular = GroupVelocityLimiter(parameters.angular_limits)

    def remap(self, before: IntArray) -> None:
        """See `GroupDriveController`."""
        self._instructed = remap_floats(self._instructed, before)
        self._linear.remap(before)
        self._angular.remap(before)

    def reset(self) -> None:
        """See `GroupDriveController`."""
        self._instructed[:] = 0.0
        self._linear.reset()
        self._angular.reset()

    def update(
        self,
        rows: IntArray,
        twists: FloatArray,
        *,
        positions: FloatArray,  # noqa: ARG002 - of the protocol
        velocities: FloatArray,
        elapsed_s: FloatArray,
    ) -> FloatArray:
        """See `GroupDriveController`."""
        desired = self._desired_rims(
            self._linear.update(rows, twists[:, VX], elapsed_s),
            self._angular.update(rows, twists[:, WZ], elapsed_s),
        )
        if self._max_acceleration > 0.0:
            desired = self._limited(rows, desired, velocities, elapsed_s)
        return np.asarray(desired / self._radii)

    def _desired_rims(self, speed: FloatArray, turn: FloatArray) -> FloatArray:
        sides = turn[:, None] * self._separations / 2.0
        rims = np.empty((len(speed), len(self._radii)))
        rims[:, 0::2] = speed[:, None] - sides
        rims[:, 1::2] = speed[:, None] + sides
        return _clamp_rows(rims, MAX_RIM_SPEED_M_S)

    def _limited(
        self, rows: IntArray, desired: FloatArray, velocities: FloatArray, elapsed_s: FloatArray
    ) -> FloatArray:
        errors = desired - velocities * self._radii
        is_near = np.abs(errors) < REACHED_M_S
        has_reached = np.repeat(is_near[:, 0::2] & is_near[:, 1::2], 2, axis=1)
        reach = self._max_acceleration * elapsed_s[:, None]
        before = self._instructed[rows]
        stepped = _limit_steps(before, desired, np.minimum(np.maximum(errors, -reach), reach))
        # What was instructed before stays remembered, as in Gazebo.
        self._instructed[rows] = np.where(has_reached, before, stepped)
        return np.where(has_reached, desired, stepped)


def _limit_steps(instructed: FloatArray, desired: FloatArray, step: FloatArray) -> FloatArray:
    highest = np.maximum(instructed, np.maximum(desired, 0.0) + MAX_LEAD_M_S)
    lowest = np.minimum(instructed, np.minimum(desired, 0.0) - MAX_LEAD_M_S)
    moved = instructed + step
    return np.where(step >= 0.0, np.minimum(moved, highest), np.maximum(moved, lowest))


class StatelessController:
    """Controllers that remember nothing of the twists before."""

    def remap(self, before: IntArray) -> None:
        """Do nothing: it remembers nothing."""

    def reset(self) -> None:
        """Do nothing: it remembers nothing."""


class GroupPlanarMotion(StatelessController):
    """See `drives.planar_move.PlanarMotion`."""

    def update(
        self,
        rows: IntArray,  # noqa: ARG002 - of the protocol
        twists: FloatArray,
        *,
        positions: FloatArray,  # noqa: ARG002
        velocities: FloatArray,  # noqa: ARG002
        elapsed_s: FloatArray,  # noqa: ARG002
    ) -> FloatArray:
        """See `GroupDriveController`."""
        return _clamp_rows(twists[:, (VX, VY, WZ)], MAX_PLANAR_SPEED)


class GroupAckermannSteering(StatelessController):
    """See `drives.ackermann.AckermannSteering`."""

    def __init__(self, parameters: AckermannDrive) -> None:
        self._parameters = parameters
        self._half_track = parameters.track_m / 2.0
        self._ratio = parameters.max_steering_angle / max(parameters.max_steer, 1e-9)

    def update(
        self,
        rows: IntArray,  # noqa: ARG002 - of the protocol
        twists: FloatArray,
        *,
        positions: FloatArray,
        velocities: FloatArray,  # noqa: ARG002 - of the protocol
        elapsed_s: FloatArray,  # noqa: ARG002 - of the protocol
    ) -> FloatArray:
        """See `GroupDriveController`."""
        parameters = self._parameters
        speed = _clamp_rows(twists[:, VX], parameters.max_speed)
        most = min(parameters.max_steer, MAX_STEER_RAD)
        steer = _clamp_rows(twists[:, WZ] * np.copysign(1.0, twists[:, VX]), most)
        slope = np.tan(steer)
        bend = slope / parameters.wheelbase_m * self._half_track
        rim = speed / parameters.wheel_radius_m
        columns = [
            rim * (1.0 - bend),
            rim * (1.0 + bend),
            np.arctan2(slope, 1.0 - bend),
            np.arctan2(slope, 1.0 + bend),
        ]
        if parameters.steering_wheel_joint:
            columns.append((positions[:, 2] + positions[:, 3]) / 2.0 * self._ratio)
        return np.stack(columns, axis=1)


class GroupTricycleSteering(StatelessController):
    """See `drives.tricycle.TricycleSteering`."""

    def __init__(self, parameters: TricycleDrive) -> None:
        self._parameters = parameters
        self._radius = parameters.actuated_wheel_diameter_m / 2.0

    def update(
        self,
        rows: IntArray,  # noqa: ARG002 - of the protocol
        twists: FloatArray,
        *,
        positions: FloatArray,
        velocities: FloatArray,
        elapsed_s: FloatArray,
    ) -> FloatArray:
        """See `GroupDriveController`."""
        wanted = _clamp_rows(twists[:, VX] / self._radius, MAX_WHEEL_SPEED)
        steering = _clamp_rows(twists[:, WZ], math.pi / 2.0)
        speed = self._limited(wanted, velocities[:, 0], elapsed_s)
        if self._parameters.max_steering_speed > 0.0:
            steering = self._steering_speed(steering - positions[:, 1], elapsed_s)
        return np.stack([speed, steering], axis=1)

    def _limited(
        self, wanted: FloatArray, current: FloatArray, elapsed_s: FloatArray
    ) -> FloatArray:
        faster, slower = self._parameters.max_acceleration, self._parameters.max_deceleration
        if faster == slower == 0.0:
            return wanted
        # 0 is no limit on its side only.
        up = current + faster * elapsed_s if faster > 0.0 else math.inf
        down = current - slower * elapsed_s if slower > 0.0 else -math.inf
        found = np.minimum(np.maximum(wanted, down), up)
        return np.where(np.abs(wanted - current) < self._parameters.speed_tolerance, wanted, found)

    def _steering_speed(self, missing_rad: FloatArray, elapsed_s: FloatArray) -> FloatArray:
        is_moving = elapsed_s > 0.0
        speed = missing_rad / np.where(is_moving, elapsed_s, 1.0)
        has_arrived = np.abs(missing_rad) < self._parameters.angle_tolerance
        found = _clamp_rows(speed, self._parameters.max_steering_speed)
        return np.where(has_arrived | ~is_moving, 0.0, found)


def _clamp_rows(values: FloatArray, limit: float) -> FloatArray:
    return np.minimum(np.maximum(values, -limit), limit)


def _clamp_rows_between(values: FloatArray, low: float | None, high: float | None) -> FloatArray:
    if high is not None:
        values = np.minimum(values, high)
    return values if low is None else np.maximum(values, low)


class GroupBaseController:
    """Keeps drives and odometries at their own rates."""

    def __init__(self, kind: GroupKey) -> None:
        drive = kind.drive
        self.targets = np.zeros((0, kind.target_count))
        """Numbers for `Model.actuators`, a row a robot."""
        self.motions = np.zeros((0, MOTION_COLUMNS))
        """As of each row's last odometry; see `motions`."""
        self._kind = kind
        self._measured = list(kind.measured)
        self._controllers = make_group_drive_controller(drive)
        self._limiters = GroupRateLimiter(drive.update_rate_hz)
        motion_hz = find_motion_rates(drive)[0]
        self._motion_limiter = None if motion_hz is None else GroupRateLimiter(motion_hz)
        self._encoders: GroupEncoderOdometry | None = None
        if (pair := drive.encoder) is not None:
            is_unsigned = drive.compat == "gazebo11"
            self._encoders = GroupEncoderOdometry(pair, is_speed_unsigned=is_unsigned)

    def remap(self, before: IntArray) -> None:
        """Carry rows over; see `rows.carried`."""
        self.targets = remap_floats(self.targets, before)
        self.motions = remap_floats(self.motions, before)
        self.motions[before < 0] = REST_MOTION
        for part in (self._controllers, self._limiters, self._motion_limiter, self._encoders):
            if part is not None:
                part.remap(before)

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self.targets[:] = 0.0
        self.motions[:] = REST_MOTION
        for part in (self._controllers, self._limiters, self._motion_limiter, self._encoders):
            if part is not None:
                part.reset()

    def update(
        self,
        time_ns: int,
        *,
        base: FloatArray,
        positions: FloatArray,
        velocities: FloatArray,
        twists: FloatArray,
    ) -> IntArray:
        """Take a state.

        Args:
            time_ns: Simulation time.
            base: States of root links, (n, STATE_COLUMNS).
            positions: Of all joints of each robot [rad or m], (n, joint_count).
            velocities: The same, a second.
            twists: As commanded, (n, 6).

        Returns:
            The rows whose motion is new.
        """
        if self._encoders is not None and self._kind.encoder is not None:
            self._encoders.update(positions[:, list(self._kind.encoder)], time_ns)
        rows, elapsed_s = self._limiters.open(time_ns)
        if len(rows):
            self.targets[rows] = self._controllers.update(
                rows,
                twists[rows],
                positions=positions[rows][:, self._measured],
                velocities=velocities[rows][:, self._measured],
                elapsed_s=elapsed_s,
            )
        if self._motion_limiter is not None:
            rows, _ = self._motion_limiter.open(time_ns)
        if len(rows):
            self.motions[rows] = self._new_motions(rows, base)
        return rows

    def _new_motions(self, rows: IntArray, base: FloatArray) -> FloatArray:
        if self._encoders is not None:
            return self._encoders.motions[rows]
        return find_world_motions(base[rows], self._kind.base_in_root)
