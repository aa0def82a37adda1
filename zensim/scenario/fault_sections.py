"""Faults of scenario files as types: what goes wrong, and when."""

from typing import Annotated

import msgspec

from zensim.scenario.quantities import described, quantity
from zensim.scenario.setting_sections import Name, Selector

Selected = Annotated[Selector, described("Robots: name, `cart*`, `cart[1-4]`, or a list of them.")]


class NearCondition(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """True while two robots are near each other."""

    near: Annotated[tuple[Name, Name], described("Two robots.")]
    below: Annotated[float, quantity("m", "Distance of their origins.", above=0.0)]


class FaultSection(
    msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="do"
):
    """Keys of every fault; `at` or `when` says when it starts."""

    name: Annotated[Name, described("Name, for checks and events.")]
    at: Annotated[float, quantity("s", "Start.", at_least=0.0)] | None = None
    when: Annotated[NearCondition, described("Start as soon as this is true.")] | None = None
    duration: Annotated[float, quantity("s", "Length; null = to the end.", above=0.0)] | None = (
        msgspec.field(default=None, name="for")
    )
    every: (
        Annotated[float, quantity("s", "Time between starts; null = once.", above=0.0)] | None
    ) = None
    probability: Annotated[float, quantity("1", "Of each start.", at_least=0.0, at_most=1.0)] = 1.0


class FaultOfRobots(FaultSection, frozen=True, kw_only=True):
    """A fault of robots."""

    robots: Selected


class CommandLoss(FaultOfRobots, frozen=True, kw_only=True, tag="command_loss"):
    """Commands of behaviours do not reach the robot; the drive keeps the last one."""

    share: Annotated[float, quantity("1", "Share of lost commands.", at_least=0.0, at_most=1.0)] = (
        1.0
    )


class CommandDelay(FaultOfRobots, frozen=True, kw_only=True, tag="command_delay"):
    """Commands of behaviours reach the robot late."""

    delay: Annotated[float, quantity("s", "Delay.", above=0.0)]


class CommandStuck(FaultOfRobots, frozen=True, kw_only=True, tag="command_stuck"):
    """The robot gets the last command from before the fault again and again."""


class CommandScale(FaultOfRobots, frozen=True, kw_only=True, tag="command_scale"):
    """Commands of behaviours are multiplied."""

    factor: Annotated[float, quantity("1", "Factor of speed and turn.")]


class AgentKill(FaultSection, frozen=True, kw_only=True, tag="agent_kill"):
    """The agent is gone: its robots are released, and their drives stop them."""

    agent: Annotated[Name, described("Name of an entry of `agents`.")]


class AgentHang(FaultSection, frozen=True, kw_only=True, tag="agent_hang"):
    """The agent does nothing: its robots keep their last commands."""

    agent: Annotated[Name, described("Name of an entry of `agents`.")]


class Push(FaultOfRobots, frozen=True, kw_only=True, tag="push"):
    """A force acts on the robot's base, in the world's axes."""

    x: Annotated[float, quantity("N", "Force along x.")] = 0.0
    y: Annotated[float, quantity("N", "Force along y.")] = 0.0
    z: Annotated[float, quantity("N", "Force along z.")] = 0.0
    link: Annotated[str, described("Link; empty = the base.")] = ""


class Kidnap(FaultOfRobots, frozen=True, kw_only=True, tag="kidnap"):
    """The robot is moved at once to another pose."""

    x: Annotated[float, quantity("m", "Position.")]
    y: Annotated[float, quantity("m", "Position.")]
    yaw: Annotated[float, quantity("rad", "Angle about z.")] = 0.0


class WheelJam(FaultOfRobots, frozen=True, kw_only=True, tag="wheel_jam"):
    """Something holds a wheel against its motor."""

    joint: Annotated[str, described("Joint of the wheel.")]


class WheelSlip(FaultOfRobots, frozen=True, kw_only=True, tag="wheel_slip"):
    """A wheel has less friction."""

    joint: Annotated[str, described("Joint of the wheel.")]
    factor: Annotated[float, quantity("1", "Of its friction.", at_least=0.0)] = 0.1


class MotorWeak(FaultOfRobots, frozen=True, kw_only=True, tag="motor_weak"):
    """A motor has less torque."""

    joint: Annotated[str, described("Joint of the motor.")]
    factor: Annotated[float, quantity("1", "Of its largest torque.", at_least=0.0)] = 0.5


class JointLock(FaultOfRobots, frozen=True, kw_only=True, tag="joint_lock"):
    """A joint stays where it is."""

    joint: Annotated[str, described("Joint that moves.")]


class LinkBroken(FaultOfRobots, frozen=True, kw_only=True, tag="link_broken"):
    """A link touches nothing any more, and is not visible; a lost wheel lets the robot down."""

    link: Annotated[str, described("Link.")]


class FaultOfSensors(FaultOfRobots, frozen=True, kw_only=True):
    """A fault of a sensor: all its topics, on the network."""

    sensor: Annotated[str, described("Name of the sensor in the description.")]


class SensorOff(FaultOfSensors, frozen=True, kw_only=True, tag="sensor_off"):
    """The sensor publishes nothing."""


class SensorStuck(FaultOfSensors, frozen=True, kw_only=True, tag="sensor_stuck"):
    """The sensor repeats its first measurement of the fault, with new stamps."""


class SensorSlow(FaultOfSensors, frozen=True, kw_only=True, tag="sensor_slow"):
    """The sensor publishes fewer messages."""

    every_nth: Annotated[
        int, msgspec.Meta(ge=2, le=10000, description="Every how many-th is published.")
    ] = 2


class SensorDelay(FaultOfSensors, frozen=True, kw_only=True, tag="sensor_delay"):
    """Messages come late, with the stamps of their measurements; rounded up to its period."""

    delay: Annotated[float, quantity("s", "Delay.", above=0.0)]


class SensorIntermittent(FaultOfSensors, frozen=True, kw_only=True, tag="sensor_intermittent"):
    """Some messages are lost."""

    share: Annotated[float, quantity("1", "Share of lost messages.", at_least=0.0, at_most=1.0)] = (
        0.5
    )


class SensorNoisy(FaultOfSensors, frozen=True, kw_only=True, tag="sensor_noise"):
    """Gaussian noise on ranges of lidars [m], or rates and accelerations of an imu."""

    deviation: Annotated[
        float, quantity("1", "Standard deviation, in the unit of the sensor.", above=0.0)
    ]


class SensorBias(FaultOfSensors, frozen=True, kw_only=True, tag="sensor_bias"):
    """A constant on ranges of lidars [m], or rates and accelerations of an imu."""

    bias: Annotated[float, quantity("1", "Bias, in the unit of the sensor.")]


class SensorSector(FaultOfSensors, frozen=True, kw_only=True, tag="sensor_sector"):
    """Rays of a scan between two angles hit nothing."""

    low: Annotated[float, quantity("rad", "First angle about z of the sensor.")]
    high: Annotated[float, quantity("rad", "Last angle.")]


class AgentSlow(FaultSection, frozen=True, kw_only=True, tag="agent_slow"):
    """The agent answers late: commands of its robots are old."""

    agent: Annotated[Name, described("Name of an entry of `agents`.")]
    delay: Annotated[float, quantity("s", "Age of the commands.", above=0.0)]
    jitter: Annotated[float, quantity("s", "Largest further age, drawn at each step.")] = 0.0


Fault = (
    CommandLoss
    | CommandDelay
    | CommandStuck
    | CommandScale
    | AgentKill
    | AgentHang
    | AgentSlow
    | Push
    | Kidnap
    | WheelJam
    | WheelSlip
    | MotorWeak
    | JointLock
    | LinkBroken
    | SensorOff
    | SensorStuck
    | SensorSlow
    | SensorDelay
    | SensorIntermittent
    | SensorNoisy
    | SensorBias
    | SensorSector
)
AGENT_FAULTS = (AgentKill, AgentHang, AgentSlow)
