"""RobotDriver: velocity commands on the bus, from a thread of its own."""

import threading
from collections.abc import Iterator
from contextlib import AbstractContextManager, closing
from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryBus, StandingClock
from tests.integration.processes import eventually
from zensim.proto.cmd_vel_decoding import decode_twist
from zensim.proto.messages.standard_messages import Twist
from zensim.proto.network_protocols import Publisher, Stamp, Subscription
from zensim.proto.path_following import PathController
from zensim.proto.topic_catalog import CMD_VEL
from zensim.spawner.page.drive_control import STOP, STOP_COMMANDS, RobotBusy, Velocity
from zensim.spawner.page.robot_driver import RobotDriver

if TYPE_CHECKING:
    from zensim.proto.network_protocols import TopicNetwork

ANN, BOB = 1, 2


@pytest.fixture
def bus() -> MemoryBus:
    return MemoryBus()


@pytest.fixture
def driver(bus: MemoryBus) -> Iterator[RobotDriver]:
    with closing(RobotDriver(bus)) as found:
        yield found


@pytest.fixture
def clock() -> StandingClock:
    return StandingClock()


@pytest.fixture
def lasting(bus: MemoryBus, clock: StandingClock) -> Iterator[RobotDriver]:
    """Make a driver whose commands last, as its clock stands."""
    with closing(RobotDriver(bus, clock)) as found:
        yield found
        clock.stands = False


@pytest.fixture
def commands(bus: MemoryBus) -> Subscription:
    return bus.subscribe(CMD_VEL.key("r1"), depth=100)


def take(commands: Subscription, stops: int = 0) -> list[Twist]:
    """Take commands, at least one, until there are enough stops among them."""
    found: list[Twist] = []

    def look() -> bool:
        found.extend(decode_twist(one.payload, one.encoding) for one in commands.take())
        return bool(found) and found.count(Twist()) >= stops

    eventually(look, 5.0, f"{stops} stops")
    return found


def test_a_held_velocity_is_published_and_ends_with_stops(
    driver: RobotDriver, commands: Subscription
) -> None:
    driver.drive(ANN, "r1", Velocity(0.5, 0.1, -0.2))

    found = take(commands, STOP_COMMANDS)

    assert (found[0].linear.x, found[0].linear.y, found[0].angular.z) == (0.5, 0.1, -0.2)
    assert found[-STOP_COMMANDS:] == [Twist()] * STOP_COMMANDS


def test_the_last_commands_of_a_driver_that_is_closed_are_stops(
    bus: MemoryBus, clock: StandingClock, commands: Subscription
) -> None:
    driver = RobotDriver(bus, clock)
    driver.drive(ANN, "r1", Velocity(0.5))
    take(commands)

    closer = threading.Thread(target=driver.close)
    closer.start()

    assert take(commands, 1)[-1] == Twist()
    clock.stands = False
    closer.join()
    assert take(commands, STOP_COMMANDS - 1)[-1] == Twist()


class FailingNetwork:
    """Raises once when a publisher is declared, then works."""

    def __init__(self, bus: MemoryBus) -> None:
        self.has_failed = False
        self._bus = bus

    def advertise(self, key: str, encoding: str) -> Publisher:
        if not self.has_failed:
            self.has_failed = True
            raise RuntimeError("the session is closed")
        return self._bus.advertise(key, encoding)

    def stamp(self) -> Stamp:
        return self._bus.stamp()

    def hold_messages(self) -> AbstractContextManager[None]:
        return self._bus.hold_messages()

    def send_held(self) -> None:
        self._bus.send_held()


def test_a_failure_of_the_network_ends_no_later_command(
    bus: MemoryBus, commands: Subscription
) -> None:
    network = FailingNetwork(bus)
    with closing(RobotDriver(cast("TopicNetwork", network))) as driver:
        driver.drive(ANN, "r2", Velocity(0.5))
        eventually(lambda: network.has_failed, 5.0, "a failure")

        driver.drive(ANN, "r1", Velocity(0.5))

        assert take(commands)[0].linear.x == 0.5


def test_a_robot_on_a_path_is_steered_by_its_poses(
    driver: RobotDriver, commands: Subscription
) -> None:
    driver.follow(ANN, "r1", PathController([(0.0, 5.0)], 0.5))
    driver.observe({"r1": (0.0, 0.0, 0.0)})

    eventually(lambda: take(commands)[-1].angular.z > 0.0, 5.0, "turning")
    assert driver.list_paths(ANN) == {"r1"}


def test_of_two_visitors_one_drives_until_the_other_takes_over(driver: RobotDriver) -> None:
    driver.drive(ANN, "r1", Velocity(0.5))
    with pytest.raises(RobotBusy):
        driver.drive(BOB, "r1", Velocity(0.5))

    assert driver.take_over(BOB, "r1") == ANN

    assert driver.find_driver("r1") == BOB


@pytest.mark.parametrize("end", ["stop_all", "release", "leave"])
def test_every_end_stops_the_robot(lasting: RobotDriver, commands: Subscription, end: str) -> None:
    lasting.drive(ANN, "r1", Velocity(0.5))
    take(commands)

    if end == "stop_all":
        lasting.stop_all(["r1"])
    else:
        getattr(lasting, end)(ANN)

    assert take(commands, 1)[-1] == Twist()


def test_a_velocity_of_zero_stops_the_robot(lasting: RobotDriver, commands: Subscription) -> None:
    lasting.drive(ANN, "r1", Velocity(0.5))
    take(commands)

    lasting.drive(ANN, "r1", STOP)

    assert take(commands, 1)[-1] == Twist()
