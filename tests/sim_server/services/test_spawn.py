"""Handlers: what a spawn does with model, name and pose."""

import math

import pytest

from tests.models import WHEEL_RADIUS_M, on_ground
from tests.sim_server.fakes import WallTime, a_world, kinds_of_events, make_parts
from tests.sim_server.orders import LYING, an_order, spawned, suspicions
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Quaternion
from zensim.sim_server.service_parts import ServerParts


def height_of(parts: ServerParts, name: str = "r") -> float:
    return float(parts.world.state_of(name)[2])


def test_spawn_puts_a_shipped_model_where_it_was_asked_for() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order("r", place=(1.0, 2.0, 0.06)))

    assert (report.entity_name, report.entity_namespace) == ("r", "r")
    assert parts.world.state_of("r")[:3] == pytest.approx([1.0, 2.0, 0.06])
    assert suspicions(report) == []
    assert kinds_of_events(parts.world) == ["spawned"]


def test_spawn_names_an_entity_after_its_model_when_no_name_was_given() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(""))

    assert report.entity_name == "box_bot"


def test_spawn_takes_a_description_as_text_and_keeps_it_for_the_agent() -> None:
    parts = make_parts(a_world())
    text = '<robot name="dot"><link name="base"/></robot>'

    report = spawned(parts, SpawnEntityOrder(entity_resource=Resource("", text)))

    assert report.entity_name == "dot"
    assert parts.world.entities.find("dot").description == text


def test_spawn_remembers_the_wall_time_of_birth() -> None:
    wall = WallTime(77)
    parts = make_parts(a_world(), wall)

    spawned(parts, an_order())

    assert parts.world.entities.find("r").born_ns == 77


def test_spawn_takes_an_all_zero_quaternion_as_identity_and_says_so() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(orientation=Quaternion(0.0, 0.0, 0.0, 0.0)))

    assert suspicions(report) == ["all-zero quaternion read as identity"]
    assert parts.world.state_of("r")[3:7].tolist() == [0.0, 0.0, 0.0, 1.0]
    assert kinds_of_events(parts.world) == ["spawned", "warning"]


def test_spawn_says_how_far_below_ground_a_robot_is_and_what_would_do() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(place=(0.0, 0.0, 0.01)))

    assert suspicions(report) == [
        "lowest point is 5.0 cm below ground; z = 0.060 puts it on the ground"
    ]
    assert height_of(parts) == 0.01


def test_spawn_puts_a_robot_on_the_ground_when_asked_to() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(place=(0.0, 0.0, 17.0), is_snapped=True))

    assert height_of(parts) == pytest.approx(0.06)
    assert suspicions(report) == []


def test_spawn_puts_a_lying_robot_on_the_ground_when_asked_to() -> None:
    parts = make_parts(a_world())

    spawned(parts, an_order(orientation=LYING, is_snapped=True))

    # Rolled to the side it stands on a wheel, 0.055 m beside its middle.
    assert height_of(parts) == pytest.approx(0.055 + 0.035)


def test_spawn_says_that_a_lying_robot_is_below_ground() -> None:
    parts = make_parts(a_world())

    report = spawned(parts, an_order(orientation=LYING))

    assert suspicions(report) == [
        "lowest point is 3.0 cm below ground; z = 0.090 puts it on the ground"
    ]


@pytest.mark.parametrize("frame_id", ["", "world", "map", "/map", "/world"])
def test_spawn_takes_a_pose_of_the_world(frame_id: str) -> None:
    parts = make_parts(a_world())

    spawned(parts, an_order(place=(3.0, 0.0, 0.06), frame_id=frame_id))

    assert parts.world.state_of("r")[0] == 3.0


def test_spawn_takes_a_pose_in_the_frame_of_another_entity() -> None:
    world = a_world("r0")
    world.place("r0", on_ground(5.0, 0.0, math.pi / 2.0))
    parts = make_parts(world)

    spawned(parts, an_order(place=(1.0, 0.0, 0.0), frame_id="r0"))

    assert world.state_of("r")[:3] == pytest.approx([5.0, 1.0, WHEEL_RADIUS_M])
