"""Joints of one robot: commands, timeouts, trajectories."""

from dataclasses import dataclass, field

import msgspec
import pytest

from tests.fakes import MemoryBus
from tests.robot_agent.models import a_claim, a_state, an_arm_bot
from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import CommandInterface, JointController, Model
from zensim.proto.messages.standard_messages import NANOSECONDS, Float64MultiArray, JointState
from zensim.proto.topic_endpoints import TopicFactory
from zensim.robot_agent.joint_control import JointControl
from zensim.robot_agent.robots import IndividualRobots

TIMEOUT_NS = NANOSECONDS // 2
FREE, POSITION, VELOCITY, EFFORT = (float(kind) for kind in JointTargetKind)
ARM_CONTROLLER = JointController("arm", ("lift", "wrist"))


@dataclass
class Arm:
    """A robot's joints."""

    model: Model = field(default_factory=an_arm_bot)
    joint_targets: tuple[float, ...] = ()
    bus: MemoryBus = field(default_factory=MemoryBus)
    time_ns: int = NANOSECONDS

    def __post_init__(self) -> None:
        claim = msgspec.structs.replace(a_claim(model=self.model), joint_targets=self.joint_targets)
        self.control = JointControl(TopicFactory(self.bus), claim, TIMEOUT_NS)

    def put(self, message: msgspec.Struct, key: str = "r1/joint_commands") -> None:
        self.bus.put_message(key, message)

    def step(self, elapsed_s: float = 0.01) -> tuple[float, ...]:
        self.time_ns += round(elapsed_s * NANOSECONDS)
        return self.control.update(self.time_ns, lambda: ([0.0] * 4, [0.0] * 4))

    def run(self, duration_s: float) -> None:
        for _ in range(round(duration_s / 0.01)):
            self.step()


def test_joints_are_free_before_their_first_command() -> None:
    assert Arm().step() == (FREE, 0.0, FREE, 0.0)


def test_command_sets_the_joints_that_it_names_and_others_go_on() -> None:
    arm = Arm()
    arm.put(JointState(name=("wrist",), position=(0.5,)))
    assert arm.step() == (FREE, 0.0, POSITION, 0.5)

    arm.put(JointState(name=("lift",), velocity=(0.1,)))

    assert arm.step() == (VELOCITY, 0.1, POSITION, 0.5)


def test_numbers_without_names_are_of_the_first_controller() -> None:
    arm = Arm()
    arm.put(Float64MultiArray(data=(0.1, 0.2)))

    assert arm.step() == (POSITION, 0.1, POSITION, 0.2)


def test_controller_that_forwards_numbers_has_a_topic_of_its_own() -> None:
    arm = Arm(
        an_arm_bot(
            ARM_CONTROLLER,
            JointController("pushes", ("wrist",), "effort", follows_trajectories=False),
        )
    )
    arm.put(Float64MultiArray(data=(3.0,)), "r1/pushes/commands")

    assert arm.step() == (FREE, 0.0, EFFORT, 3.0)


def test_commands_are_limited() -> None:
    arm = Arm()
    arm.put(JointState(name=("lift", "wrist"), position=(7.0, -7.0)))

    assert arm.step() == (POSITION, 1.0, POSITION, -1.0)


@pytest.mark.parametrize("kind", ["velocity", "effort"])
def test_velocity_and_effort_end_when_they_are_not_repeated(kind: str) -> None:
    arm = Arm()
    message = msgspec.structs.replace(JointState(name=("lift",)), **{kind: (0.5,)})
    number = {"velocity": VELOCITY, "effort": EFFORT}[kind]
    arm.put(message)
    arm.run(0.4)
    arm.put(message)
    arm.run(0.5)
    assert arm.step(0.0)[:2] == (number, 0.5)

    assert arm.step(0.02)[:2] == (number, 0.0)


def test_position_holds() -> None:
    arm = Arm()
    arm.put(JointState(name=("lift",), position=(0.5,)))
    arm.step()

    assert arm.step(100.0)[:2] == (POSITION, 0.5)


@pytest.mark.parametrize(
    "message",
    [
        JointState(name=("left_joint",), velocity=(1.0,)),
        JointState(name=("nothing",), position=(1.0,)),
        Float64MultiArray(data=(1.0,)),
    ],
)
def test_refused_commands_are_reported_and_change_nothing(message: msgspec.Struct) -> None:
    arm = Arm()
    arm.put(message)

    assert arm.step() == (FREE, 0.0, FREE, 0.0)
    assert "malformed=1" in arm.control.take_malformed_report()
    assert arm.control.take_malformed_report() == ""


def test_other_joints_of_a_message_with_a_refused_one_are_commanded() -> None:
    arm = Arm()
    arm.put(JointState(name=("left_joint", "lift"), position=(1.0, 0.3)))

    assert arm.step()[:2] == (POSITION, 0.3)


def test_held_joints_go_to_their_initial_position() -> None:
    held = JointController("arm", ("lift", "wrist"), holds=True)
    interfaces = (CommandInterface("wrist", "position", initial=0.4),)

    assert Arm(an_arm_bot(held, interfaces=interfaces)).step() == (POSITION, 0.0, POSITION, 0.4)


def test_joints_go_on_as_the_agent_before_has_left_them() -> None:
    arm = Arm(joint_targets=(POSITION, 0.7, VELOCITY, 0.1))

    assert arm.step() == (POSITION, 0.7, VELOCITY, 0.1)


def test_reset_frees_the_joints() -> None:
    arm = Arm()
    arm.put(JointState(name=("lift",), position=(0.5,)))
    arm.step()

    arm.control.reset()

    assert arm.step() == (FREE, 0.0, FREE, 0.0)


def test_robot_sends_the_targets_of_its_joints_after_those_of_its_drive() -> None:
    bus = MemoryBus()
    robots = IndividualRobots(bus, 0)
    robots.add_claims([a_claim(model=an_arm_bot())])
    bus.put_message("r1/joint_commands", JointState(name=("wrist",), position=(0.5,)))

    command = robots.advance(a_state(1, positions=(0.0,) * 4, velocities=(0.0,) * 4))

    numbers = memoryview(command.targets).cast("d").tolist()
    assert numbers == [0.0, 0.0, FREE, 0.0, POSITION, 0.5]
