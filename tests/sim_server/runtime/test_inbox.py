"""BusInbox: requests, commands and agents as they come, each taken once."""

from tests.fakes import MemoryBus, MemoryCall
from zensim.proto import keys
from zensim.proto.network_protocols import ServiceCall
from zensim.proto.topic_catalog import DRIVE_COMMAND, DRIVE_STATE
from zensim.sim_server.runtime.inbox import COMMAND_DEPTH, BusInbox


class AskingBus(MemoryBus):
    """A memory bus whose callers do not wait."""

    def ask(self, key: str) -> None:
        for queue in self._queues:
            queue.calls.append(MemoryCall(key, b"", "", b""))


def an_inbox(bus: MemoryBus) -> BusInbox:
    return BusInbox(bus, "w")


def names_of(calls: list[ServiceCall]) -> list[str]:
    return [call.name for call in calls]


def test_inbox_takes_requests_in_order_and_once() -> None:
    bus = AskingBus()
    inbox = an_inbox(bus)

    bus.ask("sim/w/info")
    bus.ask("sim/w/get_entities")

    assert names_of(inbox.take_calls()) == ["info", "get_entities"]
    assert inbox.take_calls() == []


def test_inbox_serves_every_service_of_its_world_only() -> None:
    bus = MemoryBus()

    an_inbox(bus)

    assert bus.is_served(keys.service("w", "anything"))
    assert not bus.is_served(keys.service("other", "info"))
    assert not bus.is_served(DRIVE_STATE.key("w", "a"))


def test_inbox_takes_commands_of_all_agents_in_order_and_once() -> None:
    bus = MemoryBus()
    inbox = an_inbox(bus)

    bus.put(DRIVE_COMMAND.key("w", "a"), b"1")
    bus.put(DRIVE_COMMAND.key("w", "b"), b"2")
    bus.put(DRIVE_COMMAND.key("other", "a"), b"3")

    assert [sample.payload for sample in inbox.take_commands()] == [b"1", b"2"]
    assert inbox.take_commands() == []


def test_inbox_keeps_the_newest_commands_when_nobody_takes_them() -> None:
    bus = MemoryBus()
    inbox = an_inbox(bus)

    for i in range(COMMAND_DEPTH + 3):
        bus.put(DRIVE_COMMAND.key("w", "a"), str(i).encode())

    commands = inbox.take_commands()
    assert len(commands) == COMMAND_DEPTH
    assert commands[-1].payload == str(COMMAND_DEPTH + 2).encode()


def test_inbox_tells_who_came_and_who_went() -> None:
    bus = MemoryBus()
    inbox = an_inbox(bus)

    first = bus.token(keys.alive_agent("w", "a"))
    bus.token(keys.alive_agent("w", "b"))
    first.close()

    assert inbox.take_agents() == [("a", True), ("b", True), ("a", False)]
    assert inbox.take_agents() == []


def test_inbox_tells_of_agents_that_were_there_before_the_server() -> None:
    bus = MemoryBus()
    bus.token(keys.alive_agent("w", "a"))
    bus.token(keys.alive_server("w"))

    assert an_inbox(bus).take_agents() == [("a", True)]
