"""Parameters of each drive, and a robot with it."""

from zensim.proto.messages.drive_messages import (
    AckermannDrive,
    DiffDrive,
    Drive,
    Limits,
    OmniDrive,
    PlanarMove,
    RollerWheel,
    SteeringDrive,
    TricycleDrive,
    WheelPair,
)
from zensim.proto.messages.model_messages import (
    Frame,
    Joint,
    JointStatePublisher,
    Link,
    Model,
    Origin,
)

SECOND_PAIR = WheelPair("left_rear", "right_rear", separation_m=0.5, diameter_m=0.3)
PAIR = WheelPair("left_joint", "right_joint", separation_m=0.4, diameter_m=0.2)
ACKERMANN = AckermannDrive(
    update_rate_hz=0.0, steering_wheel_joint="wheel", publish_odom=True, publish_odom_tf=True
)
DRIVES: dict[str, Drive] = {
    "diff": DiffDrive(pairs=(PAIR,), update_rate_hz=0.0, publish_odom=True, publish_odom_tf=True),
    "diff, slow to speed up": DiffDrive(
        pairs=(PAIR,),
        update_rate_hz=50.0,
        max_acceleration=1.5,
        publish_odom=True,
        publish_odom_tf=True,
    ),
    "diff by encoders": DiffDrive(
        pairs=(PAIR,),
        update_rate_hz=30.0,
        odometry_source="encoder",
        publish_odom=True,
        publish_odom_tf=True,
    ),
    "diff by encoders, as gazebo 11": DiffDrive(
        pairs=(PAIR,),
        update_rate_hz=0.0,
        odometry_source="encoder",
        odometry_rate_hz=20.0,
        compat="gazebo11",
        publish_odom=True,
        publish_odom_tf=True,
    ),
    "diff within limits": DiffDrive(
        pairs=(PAIR,),
        linear_limits=Limits(-0.5, 1.0, -2.0, 1.0),
        angular_limits=Limits(None, 1.0, None, 3.0),
        publish_odom=True,
        publish_odom_tf=True,
    ),
    "skid": DiffDrive(
        pairs=(PAIR, SECOND_PAIR), max_acceleration=0.7, publish_odom=True, publish_odom_tf=True
    ),
    "planar": PlanarMove(tf_rate_hz=10.0),
    "car": ACKERMANN,
    "tricycle": TricycleDrive(
        max_acceleration=3.0, max_deceleration=0.0, publish_odom=True, publish_odom_tf=True
    ),
    "tricycle that steers by speed": TricycleDrive(
        max_steering_speed=0.4,
        odometry_source="encoder",
        odometry_rate_hz=40.0,
        publish_odom=True,
        publish_odom_tf=True,
    ),
    "car by turn rate": SteeringDrive(
        traction=("rear_left", "rear_right"),
        steering=("front_left", "front_right"),
        passive=("spare",),
        odometry_source="encoder",
        odometry_rate_hz=50.0,
        pose_covariance=(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
        publish_odom=True,
        publish_odom_tf=True,
    ),
    "two axles that steer": SteeringDrive(
        traction=("front_left", "front_right", "rear_left", "rear_right"),
        steering=("steer_fl", "steer_fr"),
        counter_steering=("steer_rl", "steer_rr"),
        wheelbase_m=0.4,
        publish_odom=True,
        publish_odom_tf=True,
    ),
    "bicycle steered behind": SteeringDrive(
        traction=("wheel",), steering=("fork",), wheelbase_m=-0.7, max_steer=0.8, publish_odom=True
    ),
    "tricycle by turn rate": SteeringDrive(
        traction=("wheel",), steering=("fork",), is_traction_steered=True, publish_odom_tf=True
    ),
    "omni wheels within limits": OmniDrive(
        wheels=(
            RollerWheel("a", 0.0, -20.0, -4.0),
            RollerWheel("b", 17.3, 10.0, -4.0),
            RollerWheel("c", -17.3, 10.0, -4.0),
        ),
        linear_limits=Limits(-0.5, 0.5, -2.0, 2.0),
        lateral_limits=Limits(None, None, -1.0, 1.0),
        publish_odom=True,
        publish_odom_tf=True,
    ),
}


def robot_of(drive: Drive) -> Model:
    """Make a robot with this drive, a sliding lift and a camera."""
    lift = Joint(
        "lift",
        "prismatic",
        "base_link",
        "deck",
        Origin(
            (0.1, 0.0, 0.2),
            (0.034270798550482096, 0.10602051106179562, 0.1435722050167013, 0.9833474432563559),
        ),
        axis=(0.0, 0.0, 2.0),
    )
    wheels = tuple(
        Joint(name, "continuous", "base_link", f"{name}_link", Origin((0.0, 0.1, 0.0)), (0, 1, 0))
        for name in dict.fromkeys(drive.joints)
    )
    joints = (lift, *wheels)
    return Model(
        "robot",
        (Link("base_link"), *(Link(joint.child) for joint in joints)),
        joints,
        (
            Frame("base_footprint", "base_link", Origin((0.05, -0.02, -0.1))),
            Frame("camera", "deck", Origin((0.2, 0.0, 0.1))),
        ),
        drive,
        JointStatePublisher(("lift", *drive.joints[:1]), 25.0),
    )
