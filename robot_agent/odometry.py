"""Odometry from the world state or from wheel encoders, in columns, and its message."""

from collections.abc import Sequence
from typing import TypeAlias

import msgspec

from zensim.proto.drives.column_math import FLOAT_MATH, Column, ColumnMath
from zensim.proto.drives.differential_drive import find_base_step, integrate_base_step
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
from zensim.proto.rigid_transforms import (
    Rotation,
    Vector,
    add,
    cross,
    find_yaw,
    multiply,
    rotate,
    rotate_about,
)

UNKNOWN_VARIANCE = 1e12
"""Variance of what a planar robot does not measure: z, roll, pitch."""
Z_AXIS = (0.0, 0.0, 1.0)

MotionColumns: TypeAlias = tuple[
    tuple[Column, Column, Column | float], Rotation[Column], Column, Column | float, Column
]
"""Fields of `BaseMotion`, in order."""


class BaseMotion(msgspec.Struct, frozen=True, gc=False):
    """Pose of the robot's base in its odometry frame; velocities [m/s, rad/s] in the base."""

    position: Vec3 = ZERO
    orientation: Quat = IDENTITY
    linear_x: float = 0.0
    linear_y: float = 0.0
    angular_z: float = 0.0


def find_world_motion(
    state: Sequence[Column], base_in_root: Origin, xp: ColumnMath[Column]
) -> MotionColumns[Column]:
    """Find the true motion: pose in the world, velocities in the base.

    Args:
        state: Of the root link, columns as in `zensim.proto.messages.agent_messages.STATE_COLUMNS`.
        base_in_root: Fixed pose of the robot's base in its root link.
        xp: Arithmetic of the columns.
    """
    px, py, pz, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz = state
    root = (qx, qy, qz, qw)
    arm = rotate(root, base_in_root.position)
    orientation = multiply(root, base_in_root.orientation)
    # A point off the root link moves also when the link rotates.
    vx, vy, _ = add((vx, vy, vz), cross((wx, wy, wz), arm))
    yaw = find_yaw(orientation, xp)
    cos, sin = xp.cos(yaw), xp.sin(yaw)
    position = add((px, py, pz), arm)
    return position, orientation, cos * vx + sin * vy, cos * vy - sin * vx, wz


def find_encoder_motion(
    pose: Vector[Column],
    step: tuple[Column, Column],
    elapsed_s: Column,
    xp: ColumnMath[Column],
    *,
    is_speed_unsigned: bool,
) -> MotionColumns[Column]:
    """Find the motion after a step by encoders.

    Args:
        pose: x, y [m], yaw [rad] after the step.
        step: Distance [m] and rotation [rad].
        elapsed_s: Simulation time of the step; > 0.
        xp: Arithmetic of the columns.
        is_speed_unsigned: linear.x is never negative, in reverse neither: a fault of Gazebo's.
    """
    x, y, yaw = pose
    distance_m, turned_rad = step
    speed = distance_m / elapsed_s
    return (
        (x, y, 0.0),
        rotate_about(Z_AXIS, yaw, xp),
        abs(speed) if is_speed_unsigned else speed,
        0.0,
        turned_rad / elapsed_s,
    )


class EncoderOdometry:
    """Motion by the first wheel pair; starts at 0 and drifts as on a real robot."""

    def __init__(self, pair: WheelPair, *, is_speed_unsigned: bool) -> None:
        """Create odometry at 0.

        Args:
            pair: Its separation and diameter.
            is_speed_unsigned: See `find_encoder_motion`.
        """
        self._pair = pair
        self._is_speed_unsigned = is_speed_unsigned
        self.reset()

    def reset(self) -> None:
        """Start at 0 again."""
        self._before: tuple[float, float, int] | None = None
        self._pose = ZERO
        self.motion = BaseMotion()

    def update(self, *, left_rad: float, right_rad: float, time_ns: int) -> None:
        """Take the wheel joints' positions at a time of the simulation."""
        before, self._before = self._before, (left_rad, right_rad, time_ns)
        if before is None or time_ns <= before[2]:
            return
        # Positions contain every rotation; sampled velocities miss changes between two states.
        step = find_base_step(self._pair, left_rad - before[0], right_rad - before[1])
        self._pose = integrate_base_step(self._pose, *step, FLOAT_MATH)
        elapsed_s = (time_ns - before[2]) * 1e-9
        self.motion = BaseMotion(
            *find_encoder_motion(
                self._pose, step, elapsed_s, FLOAT_MATH, is_speed_unsigned=self._is_speed_unsigned
            )
        )


def make_covariances(drive: DriveSettings) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Make the 6 x 6 covariance matrices of pose and twist from a drive's variances."""
    unknown = (UNKNOWN_VARIANCE,) * 3
    planar = (drive.covariance_x, drive.covariance_y, *unknown, drive.covariance_yaw)
    return (
        _make_diagonal(drive.pose_covariance or planar),
        _make_diagonal(drive.twist_covariance or planar),
    )


def _make_diagonal(variances: Sequence[float]) -> tuple[float, ...]:
    matrix = [0.0] * 36
    matrix[::7] = variances
    return tuple(matrix)


class OdometryHeader(msgspec.Struct, frozen=True):
    """Fields that are equal in all odometry messages of one robot."""

    frame_id: str
    child_frame_id: str
    pose_covariance: tuple[float, ...]
    twist_covariance: tuple[float, ...]

    def message(self, motion: BaseMotion, stamp: Time) -> Odometry:
        """Make the message of a motion."""
        pose = Pose(Point(*motion.position), Quaternion(*motion.orientation))
        twist = Twist(
            Vector3(motion.linear_x, motion.linear_y), Vector3(0.0, 0.0, motion.angular_z)
        )
        return Odometry(
            Header(stamp, self.frame_id),
            self.child_frame_id,
            PoseWithCovariance(pose, self.pose_covariance),
            TwistWithCovariance(twist, self.twist_covariance),
        )
