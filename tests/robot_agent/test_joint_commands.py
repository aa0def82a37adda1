"""Commands of joints: what messages say, and the limits of joints."""

import math

import msgspec
import pytest

from zensim.proto.codec.message_codec import Format, MalformedPayload, encode, make_encoding
from zensim.proto.messages.drive_messages import JointTargetKind
from zensim.proto.messages.model_messages import (
    CommandInterface,
    Joint,
    JointController,
    Link,
    Model,
)
from zensim.proto.messages.standard_messages import (
    Float64MultiArray,
    JointState,
    MultiArrayDimension,
    MultiArrayLayout,
)
from zensim.robot_agent.joint_commands import (
    JointCommand,
    JointTarget,
    RefusedCommand,
    decode_joint_command,
    list_commands,
    list_joint_limits,
)

POSITION, VELOCITY, EFFORT = (
    JointTargetKind.POSITION,
    JointTargetKind.VELOCITY,
    JointTargetKind.EFFORT,
)
LIFT = Joint("lift", "prismatic", "base", "top", lower=0.0, upper=0.4, effort=50.0, velocity=0.2)
PAN = Joint("pan", "continuous", "top", "head")
NAN = math.nan


def a_model(*interfaces: CommandInterface) -> Model:
    return Model(
        "m",
        (Link("base"), Link("top"), Link("head")),
        (LIFT, PAN),
        command_interfaces=interfaces,
        joint_controllers=(JointController("c", ("lift", "pan")),),
    )


def commands_of(message: JointState | Float64MultiArray) -> list[JointCommand]:
    return list(list_commands(message, ("lift", "pan"), "position"))


@pytest.mark.parametrize("format_", [Format.CDR, Format.JSON, Format.MSGPACK])
@pytest.mark.parametrize(
    "message", [JointState(name=("lift",), position=(0.1,)), Float64MultiArray(data=(0.1, 0.2))]
)
def test_either_message_is_read_in_any_format(
    message: JointState | Float64MultiArray, format_: Format
) -> None:
    found = decode_joint_command(encode(message, format_), make_encoding(message, format_))

    assert commands_of(found) == commands_of(message)


def test_list_of_another_length_than_the_names_is_refused() -> None:
    with pytest.raises(MalformedPayload):
        decode_joint_command(encode(JointState(name=("a", "b"), effort=(1.0,)), Format.CDR))


def test_position_counts_before_velocity_and_effort_and_nan_is_none() -> None:
    message = JointState(
        name=("a", "b", "c", "d"),
        position=(1.0, NAN, NAN, NAN),
        velocity=(2.0, 3.0, NAN, NAN),
        effort=(4.0, 5.0, 6.0, NAN),
    )

    assert commands_of(message) == [
        JointCommand("a", JointTarget(POSITION, 1.0)),
        JointCommand("b", JointTarget(VELOCITY, 3.0)),
        JointCommand("c", JointTarget(EFFORT, 6.0)),
    ]


def test_numbers_are_of_the_joints_of_the_controller() -> None:
    assert commands_of(Float64MultiArray(data=(0.1, NAN))) == [
        JointCommand("lift", JointTarget(POSITION, 0.1))
    ]


def test_label_of_the_first_dimension_says_what_numbers_are() -> None:
    layout = MultiArrayLayout((MultiArrayDimension("velocity", 2, 2),))

    found = commands_of(Float64MultiArray(layout, (0.1, 0.2)))

    assert [one.target.kind for one in found] == [VELOCITY, VELOCITY]


@pytest.mark.parametrize(
    "message",
    [
        Float64MultiArray(data=(0.1,)),
        Float64MultiArray(data=(0.1, math.inf)),
        JointState(name=("lift",), velocity=(-math.inf,)),
    ],
)
def test_other_counts_and_infinite_numbers_are_refused(
    message: JointState | Float64MultiArray,
) -> None:
    with pytest.raises(MalformedPayload):
        commands_of(message)


@pytest.mark.parametrize(
    ("kind", "number", "limited"),
    [
        (POSITION, 0.5, 0.4),
        (POSITION, -1.0, 0.0),
        (VELOCITY, -9.0, -0.2),
        (EFFORT, 60.0, 50.0),
        (EFFORT, 40.0, 40.0),
    ],
)
def test_numbers_are_limited_as_the_joint_says(
    kind: JointTargetKind, number: float, limited: float
) -> None:
    limits = list_joint_limits(a_model())["lift"]

    assert limits.limit(JointTarget(kind, number)) == JointTarget(kind, limited)


@pytest.mark.parametrize("kind", [POSITION, VELOCITY, EFFORT])
def test_joint_without_limits_has_none(kind: JointTargetKind) -> None:
    limits = list_joint_limits(a_model())["pan"]

    assert limits.limit(JointTarget(kind, 1e6)).number == 1e6


def test_described_interfaces_narrow_the_limits_and_refuse_others() -> None:
    limits = list_joint_limits(a_model(CommandInterface("lift", "position", 0.1, 9.0)))["lift"]

    assert limits.limit(JointTarget(POSITION, 0.0)).number == 0.1
    assert limits.limit(JointTarget(POSITION, 8.0)).number == 0.4
    with pytest.raises(RefusedCommand):
        limits.limit(JointTarget(VELOCITY, 0.1))


def test_only_joints_of_controllers_have_limits() -> None:
    fewer = (JointController("c", ("pan",)),)

    assert list(list_joint_limits(msgspec.structs.replace(a_model(), joint_controllers=fewer))) == [
        "pan"
    ]
