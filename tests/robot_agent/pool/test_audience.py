"""Which robots' publishers are listened to."""

from tests.fakes import MemoryBus
from zensim.robot_agent.pool.audience import AT_ONCE, Audience


def an_audience(bus: MemoryBus, count: int) -> Audience[int]:
    audience = Audience[int]()
    for number in range(count):
        audience.add(number, bus.advertise(f"r{number}/odom", ""))
    return audience


def test_everybody_is_heard_until_asked_about() -> None:
    bus = MemoryBus()
    audience = an_audience(bus, 3)
    bus.subscribe("r1/odom")

    before = set(audience.heard)
    audience.ask_some()

    assert (before, set(audience.heard)) == ({0, 1, 2}, {1})


def test_all_have_been_asked_about_after_a_round_and_are_again_in_the_next() -> None:
    bus = MemoryBus()
    audience = an_audience(bus, AT_ONCE + 1)

    audience.ask_some()
    first = set(audience.heard)
    audience.ask_some()
    second = set(audience.heard)
    bus.subscribe("r0/odom")
    audience.ask_some()

    assert (first, second, set(audience.heard)) == ({AT_ONCE}, set(), {0})


def test_who_has_gone_is_heard_no_more() -> None:
    bus = MemoryBus()
    audience = an_audience(bus, AT_ONCE + 2)
    bus.subscribe("*/odom")
    audience.ask_some()

    audience.remove(AT_ONCE)
    audience.ask_some()

    assert set(audience.heard) == {*range(AT_ONCE), AT_ONCE + 1}
