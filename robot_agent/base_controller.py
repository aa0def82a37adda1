"""Base controller of one robot: drive and odometry at the drive's update rates."""

import math
from dataclasses import dataclass

from zensim.proto.drives.column_math import FLOAT_MATH
from zensim.proto.drives.drive_kinematics import make_drive_kinematics
from zensim.proto.drives.measured_joints import MeasuredJoints
from zensim.proto.messages.drive_messages import Drive
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.rate_limiter import RateLimiter
from zensim.robot_agent.drive_state_decoder import RobotState
from zensim.robot_agent.odometry import BaseMotion, EncoderOdometry, find_world_motion
from zensim.robot_agent.robot_frames import find_base_frame, get_drive


def find_motion_rates(drive: Drive) -> tuple[float | None, float | None, float | None]:
    """Find the rates [Hz] of motions, odometry and tf; 0 = at every state.

    Returns:
        Motion: None = with the drive's updates. Odometry and tf: None = with every motion.
    """
    if drive.tf_rate_hz is None:
        return drive.odometry_rate_hz, None, None
    odometry_hz, tf_hz = drive.odometry_rate_hz, drive.tf_rate_hz
    if odometry_hz is None:
        odometry_hz = drive.update_rate_hz
    motion_hz = 0.0 if 0.0 in (odometry_hz, tf_hz) else max(odometry_hz, tf_hz)
    return (
        motion_hz,
        None if odometry_hz == motion_hz else odometry_hz,
        None if tf_hz == motion_hz else tf_hz,
    )


def has_own_tf_rate(drive: Drive) -> bool:
    """Whether tf is due at other states than odometry."""
    return find_motion_rates(drive)[1:] != (None, None)


def make_rate_limiter(rate_hz: float | None) -> RateLimiter | None:
    """Make a rate limiter; none if nothing is limited."""
    return None if rate_hz is None else RateLimiter(rate_hz)


@dataclass(frozen=True, slots=True)
class _DriveUpdate:
    """Inputs of the last update of the drive, the twist apart."""

    time_ns: int
    measured: MeasuredJoints[float]
    elapsed_s: float
    state: tuple[float, ...]


class BaseController:
    """Drive and odometry of one robot, at the drive's update rates."""

    def __init__(self, model: Model) -> None:
        drive = get_drive(model)
        self._rest_targets = (0.0,) * sum(one.width for one in model.drive_actuators)
        self.targets: tuple[float, ...] = self._rest_targets
        """Targets of `Model.drive_actuators`, in order."""
        self.motion = BaseMotion()
        """Motion as of the last odometry."""
        self._base_in_root = find_base_frame(model).pose_in_root
        self._drive = make_drive_kinematics(drive, FLOAT_MATH)
        self._drive_state = (0.0,) * self._drive.state_size
        self._least_s = 1.0 / drive.update_rate_hz if drive.update_rate_hz > 0.0 else 0.0
        self._longest_s = math.inf
        self._last: _DriveUpdate | None = None
        """None if the drive was not due at the last state."""
        self._limiter = RateLimiter(drive.update_rate_hz)
        # Without its own rate a motion is due with the drive.
        self._odometry_limiter = make_rate_limiter(find_motion_rates(drive)[0])
        index = {joint.name: place for place, joint in enumerate(model.joints)}
        self._measured = tuple(index[one.joint] for one in model.drive_actuators if one.joint)
        self._encoder: EncoderOdometry | None = None
        self._encoder_wheels = (0, 0)
        if (pair := drive.encoder) is not None:
            self._encoder = EncoderOdometry(pair, is_speed_unsigned=drive.compat == "gazebo11")
            self._encoder_wheels = (index[pair.left_joint], index[pair.right_joint])

    def reset(self) -> None:
        """Reset all; time may have gone back."""
        self.targets = self._rest_targets
        self.motion = BaseMotion()
        self._last = None
        self._drive_state = (0.0,) * self._drive.state_size
        self._limiter.reset()
        if self._odometry_limiter is not None:
            self._odometry_limiter.reset()
        if self._encoder is not None:
            self._encoder.reset()

    @property
    def needs_all_states(self) -> bool:
        """Whether the motion depends on each state."""
        return self._encoder is not None

    def limit_updates(self, longest_s: float) -> None:
        """Set the most time [s] that an update counts, at least that of the update rate."""
        self._longest_s = max(longest_s, self._least_s)

    def update(self, state: RobotState, twist: Twist) -> bool:
        """Take a state; return whether odometry was due, so that the motion is new."""
        if self._encoder is not None:
            left, right = (state.positions[wheel] for wheel in self._encoder_wheels)
            self._encoder.update(left_rad=left, right_rad=right, time_ns=state.time_ns)
        is_due = self._update_drive(state, twist)
        if self._odometry_limiter is not None:
            is_due = self._odometry_limiter.elapsed_s(state.time_ns) is not None
        if is_due:
            self.motion = self._motion(state)
        return is_due

    def revise(self, twist: Twist) -> bool:
        """Repeat the last update with another twist; return whether there was one."""
        if (last := self._last) is None:
            return False
        self.targets, self._drive_state = self._drive.find_targets(
            (twist.linear.x, twist.linear.y, twist.angular.z),
            measured=last.measured,
            state=last.state,
            dt_s=min(last.elapsed_s, self._longest_s),
        )
        return True

    def _update_drive(self, state: RobotState, twist: Twist) -> bool:
        elapsed_s = self._limiter.elapsed_s(state.time_ns)
        if elapsed_s is None:
            # At the time of its update a state comes again, as further robots are claimed.
            if self._last is not None and self._last.time_ns != state.time_ns:
                self._last = None
            self.revise(twist)
            return False
        measured = MeasuredJoints(
            [state.positions[joint] for joint in self._measured],
            [state.velocities[joint] for joint in self._measured],
        )
        self._last = _DriveUpdate(state.time_ns, measured, elapsed_s, self._drive_state)
        return self.revise(twist)

    def _motion(self, state: RobotState) -> BaseMotion:
        if self._encoder is not None:
            return self._encoder.motion
        return BaseMotion(*find_world_motion(state.base, self._base_in_root, FLOAT_MATH))
