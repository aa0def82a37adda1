"""The pool of a world in its process, and what the loop publishes to it."""

from collections.abc import Iterator
from pathlib import Path

import pytest

import zensim
from zensim.api.in_process_world import get_server
from zensim.api.world_pool import POOL, WorldOutput, WorldPool
from zensim.proto.memory_bus import MemoryBus
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.sensing_messages import Contacts
from zensim.proto.messages.standard_messages import JointState
from zensim.proto.topic_catalog import CONTACTS, EVENTS, SCENE_STATE

ARM = Path(__file__).parents[3] / "examples" / "arm" / "arm_bot.urdf"
EMPTY = DriveState(0, 3, 9, b"", b"", b"", b"")


@pytest.fixture
def driven() -> Iterator[zensim.World]:
    with zensim.World(seed=1) as world:
        world.spawn("box_bot", name="r1").drive(0.3, 0.0)
        world.step(3)
        yield world


def last_state(world: zensim.World) -> DriveState:
    return dict(get_server(world).world.drive_states())[POOL]


def test_a_pool_without_robots_answers_nothing() -> None:
    pool = WorldPool(MemoryBus(), "w")

    assert pool.answer(EMPTY) is None


def test_a_state_that_was_answered_is_not_published_again(driven: zensim.World) -> None:
    host = get_server(driven)
    odom = host.subscribe("r1/odom", 8)
    driven.step(3)
    odom.take()

    again = host.pool.answer(last_state(driven))

    assert again is not None
    assert again.claims == last_state(driven).claims
    assert odom.take() == []


def test_a_state_of_a_new_epoch_resets_the_robots(driven: zensim.World) -> None:
    host = get_server(driven)

    driven.reset()

    assert host.pool.epoch == host.world.clock.epoch == 1


def test_a_refused_joint_command_is_logged_once(caplog: pytest.LogCaptureFixture) -> None:
    with zensim.World() as world:
        arm = world.spawn(ARM, name="arm")
        world.step(9)

        arm.topic("joint_commands").put(JointState(name=("nope",), position=(1.0,)))
        world.step(9)
        world.step(9)

    (line,) = [one for one in caplog.messages if "joint_commands" in one]
    assert "entity=arm" in line
    assert "'nope'" in line


def test_states_of_the_pool_are_taken_once_and_those_of_others_are_left_out() -> None:
    bus = MemoryBus()
    output = WorldOutput(bus, "w", WorldPool(bus, "w"))

    output.publish_drive_state("other", EMPTY)
    output.publish_drive_state(POOL, EMPTY)

    assert output.take_states() == [EMPTY]
    assert output.take_states() == []


def test_topics_are_wanted_by_subscribers_and_scene_states_by_nobody() -> None:
    bus = MemoryBus()
    output = WorldOutput(bus, "w", WorldPool(bus, "w"))
    assert not output.is_wanted(EVENTS)

    heard = bus.subscribe("sim/w/**", 8)
    output.publish(CONTACTS, Contacts(0, 3, 9, (), (), b"", b""))

    assert output.is_wanted(EVENTS)
    assert not output.is_wanted(SCENE_STATE)
    assert [one.key for one in heard.take()] == [CONTACTS.key("w")]
