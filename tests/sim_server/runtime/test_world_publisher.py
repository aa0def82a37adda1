"""BusOutlet: telemetry on its keys, in MessagePack, only when it is wanted."""

from typing import cast

import msgspec
import pytest

from tests.fakes import MemoryBus, MemoryPublisher
from zensim.proto import keys
from zensim.proto.bus import Bus, BusPublisher
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.agent_messages import DriveState
from zensim.proto.messages.telemetry_messages import Event, Snapshot, Stats, WorldClock
from zensim.sim_server.runtime.world_publisher import BusWorldPublisher

STATE = DriveState(1, 2, 3, b"", b"", b"", b"")
MESSAGES: dict[str, msgspec.Struct] = {
    "clock": WorldClock(step=1),
    "stats": Stats(world="w"),
    "snapshot": Snapshot(1, 2, 3, 4, ("r",), b"", b""),
    "events": Event("spawned", "r"),
}


class CountingBus(MemoryBus):
    """A memory bus that knows which publishers are open."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def advertise(self, key: str, encoding: str) -> MemoryPublisher:
        self.open.append(key)
        publisher = super().advertise(key, encoding)
        publisher.close = lambda: self.open.remove(key)  # type: ignore[method-assign]
        return publisher


def an_outlet(bus: MemoryBus) -> BusWorldPublisher:
    return BusWorldPublisher(cast("Bus", bus), "w")


@pytest.mark.parametrize(("topic", "message"), MESSAGES.items())
def test_outlet_tells_a_topic_on_its_key(topic: str, message: msgspec.Struct) -> None:
    bus = MemoryBus()
    listener = bus.subscribe(f"sim/w/{topic}")

    an_outlet(bus).publish(topic, message)

    (sample,) = listener.take()
    assert sample.encoding == "application/msgpack"
    assert decode(type(message), sample.payload, sample.encoding) == message


@pytest.mark.parametrize("topic", MESSAGES)
def test_outlet_knows_whether_somebody_listens(topic: str) -> None:
    bus = MemoryBus()
    outlet = an_outlet(bus)
    before = outlet.is_wanted(topic)

    bus.subscribe(f"sim/*/{topic}")

    assert (before, outlet.is_wanted(topic)) == (False, True)


def test_outlet_tells_each_agent_on_its_own_key() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(keys.drive_state("w", "*"), 10)
    outlet = an_outlet(bus)

    for agent in ("a", "b", "a"):
        outlet.publish_drive_state(agent, STATE)

    samples = listener.take()
    assert [sample.key for sample in samples] == [
        keys.drive_state("w", agent) for agent in ("a", "b", "a")
    ]
    assert decode(DriveState, samples[0].payload) == STATE


def test_outlet_keeps_one_publisher_for_each_agent_until_it_is_forgotten() -> None:
    bus = CountingBus()
    outlet = an_outlet(bus)
    before = len(bus.open)

    for _ in range(3):
        outlet.publish_drive_state("a", STATE)
        outlet.publish_drive_state("b", STATE)
    while_told = len(bus.open)
    outlet.forget_agent("a")
    outlet.forget_agent("nobody")

    assert while_told == before + 2
    assert bus.open[before:] == [keys.drive_state("w", "b")]


def test_outlet_tells_an_agent_again_that_was_forgotten_and_came_back() -> None:
    bus = MemoryBus()
    listener = bus.subscribe(keys.drive_state("w", "a"), 10)
    outlet = an_outlet(bus)
    outlet.publish_drive_state("a", STATE)
    outlet.forget_agent("a")

    outlet.publish_drive_state("a", STATE)

    assert len(listener.take()) == 2


def test_outlet_publishes_as_a_publisher_of_the_bus_does() -> None:
    assert {"send", "close", "is_matched"} <= set(dir(BusPublisher)) & set(dir(MemoryPublisher))
