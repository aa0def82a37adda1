"""Which twist holds when."""

from tests.fakes import MemoryBus
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.standard_messages import Twist, TwistStamped, Vector3
from zensim.robot_agent.cmd_vel import DEPTH, CommandedTwist

TIMEOUT_NS = 500
FORWARD = Twist(Vector3(1.0))
BACK = Twist(Vector3(-1.0))
STILL = Twist()


def commanded(bus: MemoryBus, timeout_ns: int = TIMEOUT_NS) -> CommandedTwist:
    return CommandedTwist(bus.subscribe("r1/cmd_vel", DEPTH), timeout_ns)


def test_twist_is_none_when_nothing_has_come() -> None:
    assert commanded(MemoryBus()).at(1000) == STILL


def test_twist_is_the_newest() -> None:
    bus = MemoryBus()
    channel = commanded(bus)

    bus.put_message("r1/cmd_vel", FORWARD)
    bus.put_message("r1/cmd_vel", BACK, Format.JSON)

    assert channel.at(1000) == BACK


def test_twist_may_be_stamped() -> None:
    bus = MemoryBus()
    channel = commanded(bus)

    bus.put_message("r1/cmd_vel", TwistStamped(twist=FORWARD))

    assert channel.at(1000) == FORWARD


def test_twist_ends_when_it_is_older_than_the_timeout() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)

    assert channel.at(1000) == FORWARD
    assert channel.at(1500) == FORWARD
    assert channel.at(1501) == STILL
    assert channel.at(1502) == STILL


def test_twist_holds_longer_when_it_is_repeated() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    channel.at(1000)
    bus.put_message("r1/cmd_vel", FORWARD)
    channel.at(1400)

    assert channel.at(1900) == FORWARD


def test_twist_holds_for_ever_when_the_timeout_is_zero() -> None:
    bus = MemoryBus()
    channel = commanded(bus, timeout_ns=0)
    bus.put_message("r1/cmd_vel", FORWARD)
    channel.at(0)

    assert channel.at(10**15) == FORWARD


def test_twist_is_forgotten_at_a_reset() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    channel.at(1000)

    channel.reset()

    assert channel.at(0) == STILL


def test_twist_that_came_before_the_first_state_after_a_reset_counts() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)

    channel.reset()

    assert channel.at(0) == FORWARD


def test_malformed_twist_does_not_hide_the_good_one_before_it() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", FORWARD)
    bus.put("r1/cmd_vel", b"garbage")

    assert channel.at(1000) == FORWARD
    assert channel.malformed == 1


def test_twist_that_is_not_finite_is_malformed() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    bus.put_message("r1/cmd_vel", Twist(Vector3(float("nan"))))

    assert channel.at(1000) == STILL
    assert channel.malformed == 1


def test_complaint_is_made_once_for_all_that_was_malformed() -> None:
    bus = MemoryBus()
    channel = commanded(bus)
    for _ in range(3):
        bus.put("r1/cmd_vel", b"garbage")
    channel.at(1000)

    assert channel.take_complaint().startswith("malformed=3 reason=")
    assert channel.take_complaint() == ""


def test_channel_is_closed_with_its_user() -> None:
    bus = MemoryBus()

    commanded(bus).close()

    assert not bus.is_heard("r1/cmd_vel")
