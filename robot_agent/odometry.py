"""Odometry of one robot from the world state or from wheel encoders, and its message."""

import math
from collections.abc import Sequence

import msgspec

from zensim.proto.messages.drive_messages import DriveSettings, WheelPair
from zensim.proto.messages.model_messages import IDENTITY, ZERO, Origin, Quat, Vec3
from zensim.proto.messages.standard_messages import (
    Header,
    Odometry,
    Point,
    Pose,
    PoseWithCovariance,
    Quaternion,
    Time,
    Twist,
    TwistWithCovariance,
    Vector3,
)
from zensim.robot_agent.scalar_transforms import (
    add,
    cross,
    find_yaw,
    from_axis_angle,
    multiply,
    rotate,
)

UNKNOWN_VARIANCE = 1e12
"""Variance of what a planar robot does not measure: z, roll, pitch."""


class BaseMotion(msgspec.Struct, frozen=True, gc=False):
    """Pose of the robot's base in its odometry frame; velocities [m/s, rad/s] in the base."""

    position: Vec3 = ZERO
    orientation: Quat = IDENTITY
    linear_x: float = 0.0
    linear_y: float = 0.0
    angular_z: float = 0.0


def find_world_motion(state: Sequence[float], base_in_root: Origin) -> BaseMotion:
    """Read the true motion: the pose is in the world, the velocity turned by its yaw.

    Args:
        state: Of the root link, in the order of `zensim.proto.messages.agent_messages.STATE_COLUMNS`.
        base_in_root: Where the robot's base is fixed on its root link.
    """
    px, py, pz, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz = state
    root: Quat = (qx, qy, qz, qw)
    arm = rotate(root, base_in_root.position)
    orientation = multiply(root, base_in_root.orientation)
    # A point that is off the root link moves also because the link turns.
    vx, vy, _ = add((vx, vy, vz), cross((wx, wy, wz), arm))
    yaw = find_yaw(orientation)
    cos, sin = math.cos(yaw), math.sin(yaw)
    return BaseMotion(
        add((px, py, pz), arm), orientation, cos * vx + sin * vy, cos * vy - sin * vx, wz
    )


class EncoderOdometry:
    """Motion as the first wheel pair tells it; starts at 0, drifts as a real robot's does."""

    def __init__(self, pair: WheelPair, *, is_speed_unsigned: bool) -> None:
        """Take the wheels.

        Args:
            pair: Its separation and diameter.
            is_speed_unsigned: linear.x is never negative, in reverse neither: a fault of Gazebo's.
        """
        self._pair = pair
        self._is_speed_unsigned = is_speed_unsigned
        self._before: tuple[float, float, int] | None = None
        self._x = self._y = self._yaw = 0.0
        self.motion = BaseMotion()

    def reset(self) -> None:
        """Start at 0 again."""
        self._before = None
        self._x = self._y = self._yaw = 0.0
        self.motion = BaseMotion()

    def update(self, *, left_rad: float, right_rad: float, time_ns: int) -> None:
        """Take the wheel joints' positions at a moment of simulation time."""
        before, self._before = self._before, (left_rad, right_rad, time_ns)
        if before is None or time_ns <= before[2]:
            return
        # Positions hold all that was turned since; speeds, sampled and summed, lose what lies
        # between two states.
        radius = self._pair.diameter_m / 2.0
        left_m, right_m = (left_rad - before[0]) * radius, (right_rad - before[1]) * radius
        self._advance((left_m + right_m) / 2.0, (right_m - left_m) / self._pair.separation_m)
        self.motion = self._motion(left_m, right_m, (time_ns - before[2]) * 1e-9)

    def _advance(self, distance_m: float, turned_rad: float) -> None:
        middle = self._yaw + turned_rad / 2.0
        self._x += distance_m * math.cos(middle)
        self._y += distance_m * math.sin(middle)
        self._yaw += turned_rad

    def _motion(self, left_m: float, right_m: float, elapsed_s: float) -> BaseMotion:
        speed = (left_m + right_m) / 2.0 / elapsed_s
        return BaseMotion(
            (self._x, self._y, 0.0),
            from_axis_angle((0.0, 0.0, 1.0), self._yaw),
            abs(speed) if self._is_speed_unsigned else speed,
            0.0,
            (right_m - left_m) / self._pair.separation_m / elapsed_s,
        )


def make_covariance(drive: DriveSettings) -> tuple[float, ...]:
    """Lay the drive's variances out as a 6 x 6 matrix, for pose and twist alike."""
    diagonal = (
        drive.covariance_x,
        drive.covariance_y,
        UNKNOWN_VARIANCE,
        UNKNOWN_VARIANCE,
        UNKNOWN_VARIANCE,
    )
    matrix = [0.0] * 36
    matrix[0:35:7] = diagonal
    matrix[35] = drive.covariance_yaw
    return tuple(matrix)


class OdometryHeader(msgspec.Struct, frozen=True):
    """What stays the same in every odometry message of one robot."""

    frame_id: str
    child_frame_id: str
    covariance: tuple[float, ...]

    def message(self, motion: BaseMotion, stamp: Time) -> Odometry:
        """Write a motion down."""
        pose = Pose(Point(*motion.position), Quaternion(*motion.orientation))
        twist = Twist(
            Vector3(motion.linear_x, motion.linear_y), Vector3(0.0, 0.0, motion.angular_z)
        )
        return Odometry(
            Header(stamp, self.frame_id),
            self.child_frame_id,
            PoseWithCovariance(pose, self.covariance),
            TwistWithCovariance(twist, self.covariance),
        )
