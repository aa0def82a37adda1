"""Drive parameters, as a description states them, and the actuators that a drive command addresses."""

from typing import Literal

import msgspec

OdometrySource = Literal["encoder", "world"]
ActuatorMode = Literal["velocity", "position", "twist"]
Compat = Literal["fixed", "gazebo11"]
"""Whether drives behave sanely, or with the documented quirks of Gazebo 11."""


class RosBlock(msgspec.Struct, frozen=True):
    """What the <ros> block of a plug-in asks for."""

    namespace: str = ""
    """Without a leading slash."""
    remappings: tuple[str, ...] = ()
    """As written: `from:=to`."""


class Actuator(msgspec.Struct, frozen=True):
    """One thing that a drive command addresses.

    `velocity` [rad/s] and `position` [rad] take one number for `joint`; `twist` takes three for the
    root link: vx, vy [m/s] ahead and to its left, wz [rad/s].
    """

    mode: ActuatorMode
    joint: str = ""
    """Empty for a twist."""
    effort: float = 0.0
    """Most that the motor gives [N m]; a twist knows no limit."""

    @property
    def width(self) -> int:
        """How many numbers address it."""
        return 3 if self.mode == "twist" else 1


class WheelPair(msgspec.Struct, frozen=True):
    """A left and a right wheel joint on one axle; separation and diameter [m], > 0."""

    left_joint: str
    right_joint: str
    separation_m: float = 0.34
    diameter_m: float = 0.15


class Limits(msgspec.Struct, frozen=True):
    """Bounds of one velocity and of its change, a second; None = unbounded."""

    min_velocity: float | None = None
    max_velocity: float | None = None
    min_acceleration: float | None = None
    max_acceleration: float | None = None


class DriveSettings(msgspec.Struct, frozen=True, kw_only=True):
    """What every drive has: how often it works, its frames, and what it publishes."""

    update_rate_hz: float = 100.0
    """Of commands; 0 = every step that the agent is told of."""
    odometry_rate_hz: float | None = None
    """None = as commands."""
    tf_rate_hz: float | None = None
    """None = as odometry."""
    odometry_source: OdometrySource = "world"
    odometry_frame: str = "odom"
    robot_base_frame: str = "base_footprint"
    publish_odom: bool = False
    publish_odom_tf: bool = False
    publish_wheel_tf: bool = False
    covariance_x: float = 1e-5
    covariance_y: float = 1e-5
    covariance_yaw: float = 1e-3
    command_topic: str = ""
    """In the robot's namespace; empty = cmd_vel."""
    odometry_topic: str = ""
    """In the robot's namespace; empty = odom."""
    ros: RosBlock = RosBlock()
    compat: Compat = "fixed"
    """gazebo11: speed by encoders is never negative, and the two topics are not read."""

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """What a command addresses, in order."""
        return ()

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """Joints whose links roll on the ground."""
        return ()

    @property
    def joints(self) -> tuple[str, ...]:
        """Every joint that the drive names."""
        return self.wheel_joints

    @property
    def steering_joints(self) -> tuple[str, ...]:
        """Joints that steer wheels."""
        return ()

    @property
    def encoder(self) -> WheelPair | None:
        """Wheels whose turns give odometry; None when the world gives it."""
        return None


class DiffDrive(DriveSettings, frozen=True, tag="diff_drive", tag_field="kind"):
    """Parameters of a differential drive, defaults as Gazebo's plug-in has them.

    Source: gazebo_ros_diff_drive of gazebo_ros_pkgs, ROS 2 branch; limits: DiffDrive of gz-sim.
    """

    pairs: tuple[WheelPair, ...] = ()
    max_torque_nm: float = 5.0
    max_acceleration: float = 0.0
    """At the rim [m/s^2]; 0 = unlimited."""
    linear_limits: Limits = Limits()
    """Of the commanded twist [m/s, m/s^2]."""
    angular_limits: Limits = Limits()
    """Of the commanded twist [rad/s, rad/s^2]."""

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """Wheels, left before right, pair by pair."""
        return tuple(joint for pair in self.pairs for joint in (pair.left_joint, pair.right_joint))

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Wheel speeds."""
        return tuple(Actuator("velocity", name, self.max_torque_nm) for name in self.wheel_joints)

    @property
    def encoder(self) -> WheelPair | None:
        """The first pair."""
        return self.pairs[0] if self.odometry_source == "encoder" and self.pairs else None


class PlanarMove(DriveSettings, frozen=True, tag="planar_move", tag_field="kind"):
    """A body that takes the commanded twist itself, sideways too; wheels or none.

    Source: gazebo_ros_planar_move of gazebo_ros_pkgs, ROS 2 branch.
    """

    update_rate_hz: float = 20.0
    publish_odom: bool = True
    publish_odom_tf: bool = True

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """The body."""
        return (Actuator("twist"),)


class AckermannDrive(DriveSettings, frozen=True, tag="ackermann_drive", tag_field="kind"):
    """Parameters of a car: rear wheels drive, front wheels steer.

    Source: gazebo_ros_ackermann_drive of gazebo_ros_pkgs, ROS 2 branch; lengths are measured from
    the links, as there.
    """

    rear_left_joint: str = "rear_left_joint"
    rear_right_joint: str = "rear_right_joint"
    front_left_joint: str = "front_left_joint"
    front_right_joint: str = "front_right_joint"
    left_steering_joint: str = "left_steering_joint"
    right_steering_joint: str = "right_steering_joint"
    steering_wheel_joint: str = ""
    wheel_radius_m: float = 0.3
    """Of the rear wheels; > 0."""
    wheelbase_m: float = 1.0
    """Between the axles; > 0."""
    track_m: float = 0.5
    """Between the front wheels; > 0."""
    max_speed: float = 20.0
    """[m/s]."""
    max_steer: float = 0.6
    """Of the front wheels [rad]."""
    max_steering_angle: float = 7.85
    """Of the steering wheel [rad]."""
    wheel_effort_nm: float = 100.0
    steering_effort_nm: float = 100.0

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """Rear wheels, then front wheels."""
        return (
            self.rear_left_joint,
            self.rear_right_joint,
            self.front_left_joint,
            self.front_right_joint,
        )

    @property
    def joints(self) -> tuple[str, ...]:
        """Wheels and steering."""
        return (*self.wheel_joints, *self._turned_joints)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Speeds of the rear wheels, angles of the steering joints, then of the steering wheel."""
        return (
            Actuator("velocity", self.rear_left_joint, self.wheel_effort_nm),
            Actuator("velocity", self.rear_right_joint, self.wheel_effort_nm),
            *(Actuator("position", j, self.steering_effort_nm) for j in self._turned_joints),
        )

    @property
    def steering_joints(self) -> tuple[str, ...]:
        """Joints that steer the front wheels, left before right."""
        return (self.left_steering_joint, self.right_steering_joint)

    @property
    def _turned_joints(self) -> tuple[str, ...]:
        wheel = (self.steering_wheel_joint,) if self.steering_wheel_joint else ()
        return (*self.steering_joints, *wheel)


class TricycleDrive(DriveSettings, frozen=True, tag="tricycle_drive", tag_field="kind"):
    """Parameters of a tricycle: one wheel drives and steers, two follow and count.

    Source: gazebo_ros_tricycle_drive of gazebo_ros_pkgs, ROS 2 branch.
    """

    robot_base_frame: str = "base_link"
    steering_joint: str = "front_steering_joint"
    actuated_wheel_joint: str = "front_wheel_joint"
    encoder_wheel_left_joint: str = "left_wheel_joint"
    encoder_wheel_right_joint: str = "right_wheel_joint"
    actuated_wheel_diameter_m: float = 0.15
    encoder_wheel_diameter_m: float = 0.15
    wheel_separation_m: float = 0.5
    max_torque_nm: float = 0.15
    """Of the actuated wheel, and of steering by speed."""
    max_acceleration: float = 0.0
    """Of the actuated wheel [rad/s^2]; 0 = unlimited."""
    max_deceleration: float = 0.0
    """[rad/s^2]; 0 = unlimited."""
    speed_tolerance: float = 0.01
    """A wheel this close to its speed [rad/s] has reached it."""
    max_steering_speed: float = 0.0
    """[rad/s]; 0 = the angle is set."""
    angle_tolerance: float = 0.01
    """[rad]."""
    steering_effort_nm: float = 100.0
    """Where the angle is set."""

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """The wheel that drives, then the two that count."""
        return (
            self.actuated_wheel_joint,
            self.encoder_wheel_left_joint,
            self.encoder_wheel_right_joint,
        )

    @property
    def steering_joints(self) -> tuple[str, ...]:
        """Joint that steers the wheel that drives."""
        return (self.steering_joint,)

    @property
    def joints(self) -> tuple[str, ...]:
        """Wheels and steering."""
        return (*self.wheel_joints, self.steering_joint)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Speed of the actuated wheel, then the steering: its speed when that is limited."""
        steering = (
            Actuator("velocity", self.steering_joint, self.max_torque_nm)
            if self.max_steering_speed > 0.0
            else Actuator("position", self.steering_joint, self.steering_effort_nm)
        )
        return (Actuator("velocity", self.actuated_wheel_joint, self.max_torque_nm), steering)

    @property
    def encoder(self) -> WheelPair | None:
        """The two wheels that count."""
        if self.odometry_source != "encoder":
            return None
        return WheelPair(
            self.encoder_wheel_left_joint,
            self.encoder_wheel_right_joint,
            self.wheel_separation_m,
            self.encoder_wheel_diameter_m,
        )


Drive = DiffDrive | PlanarMove | AckermannDrive | TricycleDrive
