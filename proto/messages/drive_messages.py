"""Drive parameters of a description, and the actuators of drive commands.

The garbage collector does not track them, as `model_messages` says.
"""

from enum import IntEnum
from typing import Final, Literal, get_args

import msgspec

OdometrySource = Literal["encoder", "world"]
ActuatorMode = Literal["velocity", "position", "twist", "joint"]
Compat = Literal["fixed", "gazebo11"]
COMPATS: Final[tuple[Compat, ...]] = get_args(Compat)
"""Corrected behaviour, or that of Gazebo 11 with its documented errors."""
PAIR_SIZE = 2
"""Number of wheels of a pair."""
TARGETS_OF_MODE = {"twist": 3, "joint": 2}
"""Number of targets of an actuator; 1 of other modes."""


class JointTargetKind(IntEnum):
    """What the motor of a joint does; the first of the two targets of a `joint` actuator."""

    FREE = 0
    """No effort: the joint has its friction, damping and spring."""
    POSITION = 1
    VELOCITY = 2
    EFFORT = 3


class RosBlock(msgspec.Struct, frozen=True, gc=False):
    """The `<ros>` element of a plug-in."""

    namespace: str = ""
    """Namespace without a leading slash."""
    remappings: tuple[str, ...] = ()
    """Rules as written: `from:=to`."""


class Actuator(msgspec.Struct, frozen=True, gc=False):
    """One actuator of a drive command.

    `velocity` [rad/s] and `position` [rad] have one target, for `joint`; `twist` has three, for the
    root link: vx, vy [m/s] forward and left, wz [rad/s]. `joint` has two: a `JointTargetKind`, and
    a position [rad or m], velocity [rad/s or m/s] or effort [N m or N] of that kind.
    """

    mode: ActuatorMode
    joint: str = ""
    """Empty for a twist."""
    effort: float = 0.0
    """Maximum motor torque [N m]; not used for a twist; 0 of a `joint` = unlimited."""

    @property
    def width(self) -> int:
        """Number of targets."""
        return TARGETS_OF_MODE.get(self.mode, 1)


class WheelPair(msgspec.Struct, frozen=True, gc=False):
    """A left and a right wheel joint on one axle; separation and diameter [m], > 0."""

    left_joint: str
    right_joint: str
    separation_m: float = 0.34
    diameter_m: float = 0.15
    is_left_reversed: bool = False
    """Whether the axis of the joint points to the right, so that positive speeds roll backward."""
    is_right_reversed: bool = False

    @property
    def radii_m(self) -> tuple[float, float]:
        """Way ahead of the left and the right rim per radian of their joints [m]."""
        radius = self.diameter_m / 2.0
        return (
            -radius if self.is_left_reversed else radius,
            -radius if self.is_right_reversed else radius,
        )


class Limits(msgspec.Struct, frozen=True, gc=False):
    """Bounds of a velocity and of its acceleration; None = unbounded."""

    min_velocity: float | None = None
    max_velocity: float | None = None
    min_acceleration: float | None = None
    max_acceleration: float | None = None


class DriveSettings(msgspec.Struct, frozen=True, gc=False, kw_only=True):
    """Rates, frames, odometry and topics of every drive."""

    update_rate_hz: float = 100.0
    """Rate of commands; 0 = at every drive state."""
    odometry_rate_hz: float | None = None
    """None = rate of commands."""
    tf_rate_hz: float | None = None
    """None = rate of odometry."""
    odometry_source: OdometrySource = "world"
    odometry_frame: str = "odom"
    robot_base_frame: str = "base_footprint"
    publish_odom: bool = False
    publish_odom_tf: bool = False
    publish_wheel_tf: bool = False
    covariance_x: float = 1e-5
    covariance_y: float = 1e-5
    covariance_yaw: float = 1e-3
    pose_covariance: tuple[float, ...] = ()
    """Diagonal (6,): x, y, z, roll, pitch, yaw; empty = from the three variances above."""
    twist_covariance: tuple[float, ...] = ()
    """Diagonal (6,) of the twist, as that of the pose."""
    command_topic: str = ""
    """Topic in the robot's namespace; empty = cmd_vel."""
    odometry_topic: str = ""
    """Topic in the robot's namespace; empty = odom."""
    ros: RosBlock = RosBlock()
    compat: Compat = "fixed"
    """gazebo11: encoder speed is never negative, and the two topics are ignored."""

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Actuators of a command, in order."""
        return ()

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """Joints of wheels."""
        return ()

    @property
    def joints(self) -> tuple[str, ...]:
        """All joints of the drive."""
        return self.wheel_joints

    @property
    def steering_joints(self) -> tuple[str, ...]:
        """Joints that steer wheels."""
        return ()

    @property
    def encoder(self) -> WheelPair | None:
        """Wheels of encoder odometry; None if the odometry source is the world."""
        return None


class DiffDrive(DriveSettings, frozen=True, tag="diff_drive", tag_field="kind"):
    """Parameters of a differential drive, with the defaults of Gazebo's plug-in.

    Source: gazebo_ros_diff_drive of gazebo_ros_pkgs, ROS 2 branch; limits: DiffDrive of gz-sim.
    """

    pairs: tuple[WheelPair, ...] = ()
    max_torque_nm: float = 5.0
    max_acceleration: float = 0.0
    """Acceleration at the rim [m/s^2]; 0 = unlimited."""
    linear_limits: Limits = Limits()
    """Limits of the commanded twist [m/s, m/s^2]."""
    angular_limits: Limits = Limits()
    """Limits of the commanded twist [rad/s, rad/s^2]."""

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
    """A body that moves with the commanded twist, in any direction; with or without wheels.

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
    """Parameters of a car with driven rear wheels and steered front wheels.

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
    """Radius of the rear wheels; > 0."""
    wheelbase_m: float = 1.0
    """Distance of the axles; > 0."""
    track_m: float = 0.5
    """Distance of the front wheels; > 0."""
    max_speed: float = 20.0
    """[m/s]."""
    max_steer: float = 0.6
    """Largest angle of the front wheels [rad]."""
    max_steering_angle: float = 7.85
    """Largest angle of the steering wheel [rad]."""
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
    """Parameters of a tricycle: one driven and steered wheel, two passive wheels with encoders.

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
    """Torque of the actuated wheel, and of the steering joint if its speed is limited."""
    max_acceleration: float = 0.0
    """Acceleration of the actuated wheel [rad/s^2]; 0 = unlimited."""
    max_deceleration: float = 0.0
    """[rad/s^2]; 0 = unlimited."""
    speed_tolerance: float = 0.01
    """Tolerance [rad/s] of the wheel speed."""
    max_steering_speed: float = 0.0
    """[rad/s]; 0 = the steering joint is position controlled."""
    angle_tolerance: float = 0.01
    """[rad]."""
    steering_effort_nm: float = 100.0
    """Effort of a position controlled steering joint."""

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """The driven wheel, then the two with encoders."""
        return (
            self.actuated_wheel_joint,
            self.encoder_wheel_left_joint,
            self.encoder_wheel_right_joint,
        )

    @property
    def steering_joints(self) -> tuple[str, ...]:
        """Steering joint of the driven wheel."""
        return (self.steering_joint,)

    @property
    def joints(self) -> tuple[str, ...]:
        """Wheels and steering."""
        return (*self.wheel_joints, self.steering_joint)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Speed of the driven wheel, then angle or speed of the steering joint."""
        steering = (
            Actuator("velocity", self.steering_joint, self.max_torque_nm)
            if self.max_steering_speed > 0.0
            else Actuator("position", self.steering_joint, self.steering_effort_nm)
        )
        return (Actuator("velocity", self.actuated_wheel_joint, self.max_torque_nm), steering)

    @property
    def encoder(self) -> WheelPair | None:
        """The two passive wheels."""
        if self.odometry_source != "encoder":
            return None
        return WheelPair(
            self.encoder_wheel_left_joint,
            self.encoder_wheel_right_joint,
            self.wheel_separation_m,
            self.encoder_wheel_diameter_m,
        )


class SteeringDrive(DriveSettings, frozen=True, tag="steering_drive", tag_field="kind"):
    """Parameters of a car, bicycle or tricycle whose turn rate is commanded, not its angle.

    Source: ackermann_, bicycle_, tricycle_steering_controller and tricycle_controller of
    ros2_controllers, four_wheel_steering_controller of ROS 1, AckermannSteering of gz-sim.
    """

    traction: tuple[str, ...] = ()
    """Joints of driven wheels: one, or left and right; of either axle if both steer."""
    steering: tuple[str, ...] = ()
    """Steering joints: one, or left and right."""
    counter_steering: tuple[str, ...] = ()
    """Left and right steering joint of a second axle, which turns by the opposite angle."""
    reversed_wheels: tuple[str, ...] = ()
    """Driven joints whose axis points to the right, so that positive speeds roll backward."""
    passive: tuple[str, ...] = ()
    """Joints of other wheels."""
    is_traction_steered: bool = False
    """Whether the only driven wheel is the steered one."""
    wheel_radius_m: float = 0.3
    """Radius of the driven wheels; > 0."""
    wheelbase_m: float = 1.0
    """Distance from the unsteered to the steered axle along x; not 0, negative if that is behind.
    If two axles steer, from the middle between them."""
    traction_track_m: float = 0.5
    """Distance of two driven wheels; > 0."""
    steering_track_m: float = 0.5
    """Distance of two steered wheels; > 0."""
    max_speed: float = 20.0
    """[m/s]."""
    max_steer: float = 1.5
    """[rad]."""
    wheel_effort_nm: float = 100.0
    steering_effort_nm: float = 100.0

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """Driven wheels, then the others."""
        return (*self.traction, *self.passive)

    @property
    def steering_joints(self) -> tuple[str, ...]:
        """Steering joints, left before right, axle by axle."""
        return (*self.steering, *self.counter_steering)

    @property
    def joints(self) -> tuple[str, ...]:
        """Wheels and steering."""
        return (*self.wheel_joints, *self.steering_joints)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """Speeds of the driven wheels, then angles of the steering joints."""
        return (
            *(Actuator("velocity", joint, self.wheel_effort_nm) for joint in self.traction),
            *(Actuator("position", one, self.steering_effort_nm) for one in self.steering_joints),
        )

    @property
    def encoder(self) -> WheelPair | None:
        """The two driven wheels, if they are not steered."""
        if self.odometry_source != "encoder" or len(self.traction) != PAIR_SIZE:
            return None
        left, right = self.traction
        return WheelPair(
            left,
            right,
            self.traction_track_m,
            2.0 * self.wheel_radius_m,
            is_left_reversed=left in self.reversed_wheels,
            is_right_reversed=right in self.reversed_wheels,
        )


class RollerWheel(msgspec.Struct, frozen=True, gc=False):
    """A wheel with rollers: its speed is linear in the twist of the base."""

    joint: str
    ahead: float
    """Wheel speed by vx [rad/m]."""
    left: float
    """Wheel speed by vy [rad/m]."""
    turn: float
    """Wheel speed by wz, without unit."""


class OmniDrive(DriveSettings, frozen=True, tag="omni_drive", tag_field="kind"):
    """Parameters of a base on mecanum or omni wheels, which moves in any direction.

    The twist is applied to the body, as rollers are no part of descriptions; the wheels turn as
    they would.

    Source: mecanum_drive_controller and omni_wheel_drive_controller of ros2_controllers.
    """

    wheels: tuple[RollerWheel, ...] = ()
    max_torque_nm: float = 5.0
    """Torque of each wheel, which has only itself to turn."""
    linear_limits: Limits = Limits()
    """Limits of vx [m/s, m/s^2]."""
    lateral_limits: Limits = Limits()
    """Limits of vy [m/s, m/s^2]."""
    angular_limits: Limits = Limits()
    """Limits of wz [rad/s, rad/s^2]."""

    @property
    def wheel_joints(self) -> tuple[str, ...]:
        """Joints of the wheels."""
        return tuple(wheel.joint for wheel in self.wheels)

    @property
    def actuators(self) -> tuple[Actuator, ...]:
        """The body, then the wheels."""
        return (
            Actuator("twist"),
            *(Actuator("velocity", wheel.joint, self.max_torque_nm) for wheel in self.wheels),
        )


Drive = DiffDrive | PlanarMove | AckermannDrive | TricycleDrive | SteeringDrive | OmniDrive


def name_drive(drive: Drive | None) -> str:
    """Name the kind of a drive, such as `diff_drive`; empty without one."""
    return "" if drive is None else str(drive.__struct_config__.tag)


DriveKind = Literal[
    "", "none", "diff", "mecanum", "omni", "ackermann", "bicycle", "tricycle", "planar"
]


class DriveOrder(msgspec.Struct, frozen=True, gc=False):
    """A drive that a spawn request gives to a robot, in place of that of its description."""

    kind: DriveKind = ""
    """Empty = that of the description; `none` = no drive."""
    joints: tuple[str, ...] = ()
    """Driven wheels, then steering joints.

    diff: left and right, pair by pair. mecanum: front left, front right, rear left, rear right.
    omni: three or more wheels. ackermann: left and right wheel, left and right steering joint; or
    four wheels and four steering joints, front left, front right, rear left, rear right.
    bicycle: wheel and steering joint. tricycle: left and right wheel and steering joint, or the
    wheel that drives and steers and its steering joint. planar: none.
    """
    separation_m: float = 0.0
    """Distance of left and right wheels; 0 = measured from the links."""
    diameter_m: float = 0.0
    """Diameter of driven wheels; 0 = measured from the links."""
    wheelbase_m: float = 0.0
    """Distance of front and rear axle; 0 = measured from the links."""
