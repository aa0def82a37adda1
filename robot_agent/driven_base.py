"""A robot's base under its drive: readings and twists in, wheel speeds and odometry out."""

from proto.geometry import Twist
from proto.model import DiffDrive, Model
from robot_agent.drives.diff_drive import DifferentialDrive
from robot_agent.frames import base_of
from robot_agent.odometry import EncoderOdometry, Motion, world_motion
from robot_agent.rate_gate import RateGate
from robot_agent.reading import Reading

NO_DRIVE = DiffDrive(update_rate_hz=30.0)
"""Has no wheels and publishes nothing: stands in where a description has no drive."""


def drive_of(model: Model) -> DiffDrive:
    """Find the drive; one that does nothing when there is none."""
    return model.drive or NO_DRIVE


class DrivenBase:
    """Keeps a drive and its odometry at the drive's own rate."""

    def __init__(self, model: Model, *, is_encoder_speed_unsigned: bool) -> None:
        drive = drive_of(model)
        names = [joint.name for joint in model.joints]
        self._wheels = tuple(names.index(name) for name in model.driven_joints)
        self.targets: tuple[float, ...] = (0.0,) * len(self._wheels)
        """Wheel speeds [rad/s] in the order of `Model.driven_joints`."""
        self.motion = Motion()
        """As of the last update."""
        self._base_in_root = base_of(model).in_root
        self._drive = DifferentialDrive(drive)
        self._gate = RateGate(drive.update_rate_hz)
        self._encoder: EncoderOdometry | None = None
        if drive.odometry_source == "encoder" and drive.pairs:
            self._encoder = EncoderOdometry(
                drive.pairs[0], is_speed_unsigned=is_encoder_speed_unsigned
            )

    def reset(self) -> None:
        """Start again: time may have gone back."""
        self.targets = (0.0,) * len(self._wheels)
        self.motion = Motion()
        self._drive.reset()
        self._gate.reset()
        if self._encoder is not None:
            self._encoder.reset()

    def update(self, reading: Reading, twist: Twist) -> bool:
        """Take a reading; tell whether the drive was due, so that targets and motion are new."""
        if self._encoder is not None:
            left, right = (reading.positions[wheel] for wheel in self._wheels[:2])
            self._encoder.update(left_rad=left, right_rad=right, time_ns=reading.time_ns)
        elapsed_s = self._gate.elapsed_s(reading.time_ns)
        if elapsed_s is None:
            return False
        velocities = [reading.velocities[wheel] for wheel in self._wheels]
        self.targets = self._drive.update(twist, wheel_velocities=velocities, elapsed_s=elapsed_s)
        self.motion = self._motion(reading)
        return True

    def _motion(self, reading: Reading) -> Motion:
        if self._encoder is not None:
            return self._encoder.motion
        return world_motion(reading.base, self._base_in_root)
