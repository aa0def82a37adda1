"""Small models for tests, built without a description."""

import math

import msgspec
import numpy as np
import pytest

from zensim.proto.messages.drive_messages import DiffDrive, PlanarMove, TricycleDrive, WheelPair
from zensim.proto.messages.model_messages import (
    Inertial,
    Joint,
    JointController,
    JointKind,
    Link,
    Model,
    Origin,
    Shape,
)
from zensim.proto.se3 import from_rpy
from zensim.sim_server.description.builtin_models import read_builtin_model
from zensim.sim_server.description.urdf.urdf_parser import read_urdf
from zensim.sim_server.physics.engine import FloatArray

WHEEL_RADIUS_M = 0.05
TRACK_M = 0.3


def a_state(
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    turn: tuple[float, float, float] = (0.0, 0.0, 0.0),
    linear: tuple[float, float, float] = (0.0, 0.0, 0.0),
    angular: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> FloatArray:
    """Make a state row (13,) from a position, roll pitch yaw, and velocities."""
    return np.concatenate([place, from_rpy(*turn), linear, angular])


def a_body(mass_kg: float = 1.0, moment: float = 0.01) -> Inertial:
    return Inertial(mass_kg, inertia=(moment, 0.0, 0.0, moment, 0.0, moment))


def a_box(
    name: str = "box", side_m: float = 0.2, *, friction: float = 1.0, is_static: bool = False
) -> Model:
    """A cube about its root, at rest on the ground when spawned at half its side."""
    cube = Shape("box", (side_m, side_m, side_m), friction=friction)
    return Model(name, (Link("base", a_body(), (cube,)),), is_static=is_static)


def a_lopsided_box(name: str = "lopsided") -> Model:
    """A box whose centre of mass and principal axes are not those of its root link."""
    inertial = Inertial(2.0, (0.3, -0.2, 0.1), (0.05, 0.01, -0.008, 0.07, 0.006, 0.09))
    return Model(name, (Link("base", inertial, (Shape("box", (0.2, 0.2, 0.2)),)),))


def an_arm(kind: JointKind, *, damping: float = 0.0, friction: float = 0.0) -> Model:
    """A fixed post with one suspended, passive link; joint limits -0.5 to 0.5."""
    joint = Joint(
        "swing",
        kind,
        "post",
        "arm",
        Origin((0.0, 0.0, 1.0)),
        axis=(0.0, 1.0, 0.0) if kind != "prismatic" else (0.0, 0.0, 1.0),
        lower=-0.5,
        upper=0.5,
        damping=damping,
        friction=friction,
    )
    hanging = Inertial(1.0, (0.2, 0.0, 0.0), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    return Model("arm", (Link("post", a_body()), Link("arm", hanging)), (joint,), is_static=True)


def a_cart(name: str = "cart") -> Model:
    """A two-wheeled robot whose joints are in reverse order of its drive."""
    wheel = Link("", a_body(0.2, 2.5e-4), (Shape("sphere", (WHEEL_RADIUS_M, 0.0, 0.0)),))
    caster = Shape(
        "sphere", (0.02, 0.0, 0.0), Origin((0.1, 0.0, 0.02 - WHEEL_RADIUS_M + 0.0005)), friction=0.0
    )
    back = Shape(
        "sphere",
        (0.02, 0.0, 0.0),
        Origin((-0.1, 0.0, 0.02 - WHEEL_RADIUS_M + 0.0005)),
        friction=0.0,
    )
    deck = Shape("box", (0.25, 0.2, 0.04), Origin((0.0, 0.0, 0.02)))
    return Model(
        name,
        (
            Link("base", a_body(2.0, 0.02), (deck, caster, back)),
            Link("right", wheel.inertial, wheel.collisions),
            Link("left", wheel.inertial, wheel.collisions),
        ),
        (_axle("right", -TRACK_M / 2.0), _axle("left", TRACK_M / 2.0)),
        drive=DiffDrive(
            (WheelPair("left_joint", "right_joint", TRACK_M, 2.0 * WHEEL_RADIUS_M),),
            max_torque_nm=2.0,
        ),
    )


def _axle(side: str, y: float) -> Joint:
    return Joint(
        f"{side}_joint", "continuous", "base", side, Origin((0.0, y, 0.0)), axis=(0.0, 1.0, 0.0)
    )


def on_ground(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """Make the state of a cart at rest on its wheels."""
    return a_state((x, y, WHEEL_RADIUS_M), turn=(0.0, 0.0, yaw))


SENSOR_POLE = """<robot name="pole"><link name="base"><inertial><mass value="30"/>
<inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
<collision><origin xyz="0 0 0.1"/><geometry><box size="0.4 0.4 0.2"/></geometry></collision></link>
<link name="top"/><joint name="t" type="fixed"><parent link="base"/><child link="top"/>
<origin xyz="0 0 0.5"/></joint>
<gazebo reference="top">
<sensor name="imu" type="imu"><topic>imu</topic><update_rate>20</update_rate></sensor>
<sensor name="gps" type="navsat"><topic>fix</topic><update_rate>5</update_rate></sensor>
<sensor name="compass" type="magnetometer"><update_rate>5</update_rate></sensor>
<sensor name="height" type="altimeter"><update_rate>5</update_rate></sensor></gazebo>
<gazebo reference="base"><sensor name="bump" type="contact"><update_rate>20</update_rate></sensor>
</gazebo></robot>"""
"""Sensors without a drive and without joints that move."""
POLE_TOPICS = (
    "imu", "fix", "magnetic_field", "altimeter", "bumper_states", "tf_static", "robot_description",
)  # fmt: skip


def a_box_bot() -> Model:
    return read_urdf(read_builtin_model("box_bot"))


def box_bot_at(x: float = 0.0, y: float = 0.0, yaw: float = 0.0) -> FloatArray:
    """Make the state of a box_bot at rest on its wheels."""
    return a_state((x, y, 0.06), turn=(0.0, 0.0, yaw))


def angle_between(left: FloatArray, right: FloatArray) -> float:
    """Find the angle [rad] between two orientations, whatever their signs."""
    return 2.0 * math.acos(min(1.0, abs(float(np.dot(left, right)))))


def assert_same_state(found: FloatArray, expected: FloatArray) -> None:
    assert found[:3] == pytest.approx(expected[:3], abs=1e-9)
    assert angle_between(found[3:7], expected[3:7]) < 1e-7
    assert found[7:] == pytest.approx(expected[7:], abs=1e-9)


def a_puck(name: str = "puck") -> Model:
    """A slab with a planar drive and an offset centre of mass."""
    slab = Shape("box", (0.3, 0.2, 0.1), Origin((0.05, 0.0, 0.05)))
    inertial = Inertial(3.0, (0.05, 0.02, 0.04), (0.02, 0.0, 0.0, 0.03, 0.0, 0.04))
    return Model(name, (Link("base", inertial, (slab,)),), drive=PlanarMove())


def a_fork(*, effort: float = 5.0) -> Model:
    """A fixed post with a steered joint and three wheel joints."""
    names = ("wheel", "left", "right", "steering")
    links = (Link("post", a_body()), *(Link(name, a_body(0.5)) for name in names))
    joints = tuple(
        Joint(name, "continuous", "post", name, Origin((0.3 * i, 0.0, 1.0)), axis=(0.0, 0.0, 1.0))
        for i, name in enumerate(names)
    )
    drive = TricycleDrive(
        actuated_wheel_joint="wheel",
        encoder_wheel_left_joint="left",
        encoder_wheel_right_joint="right",
        steering_joint="steering",
        max_torque_nm=5.0,
        steering_effort_nm=effort,
    )
    return Model("fork", links, joints, drive=drive, is_static=True)


def a_controlled_arm(
    *, effort: float = 20.0, velocity: float = 1.0, kind: JointKind = "revolute"
) -> Model:
    """The arm of `an_arm` with a motor; its moment of gravity at 0 is 1.962 N m about +y."""
    arm = an_arm(kind, damping=0.01)
    joint = msgspec.structs.replace(arm.joints[0], effort=effort, velocity=velocity)
    return msgspec.structs.replace(
        arm, joints=(joint,), joint_controllers=(JointController("c", ("swing",)),)
    )
