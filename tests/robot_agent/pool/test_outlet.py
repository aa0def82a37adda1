"""A topic of many robots on its plain keys: put where somebody listens."""

from tests.fakes import MemoryBus
from zensim.proto.messages.standard_messages import String
from zensim.robot_agent.pool.outlet import FleetOutlet, Line


class Nothing:
    """Has no value of any row; see `outlet.Values`."""

    def payload(self, row: int) -> bytes | None:
        del row
        return None


class CountingBus(MemoryBus):
    """Keeps the keys of all that was put, heard or not."""

    def __init__(self) -> None:
        super().__init__()
        self.put_on: list[str] = []

    def put(self, key: str, payload: bytes, encoding: str = "", attachment: bytes = b"") -> None:
        self.put_on.append(key)
        super().put(key, payload, encoding, attachment)


def an_outlet(bus: MemoryBus, *names: str) -> tuple[FleetOutlet, list[Line]]:
    outlet = FleetOutlet(bus, "*/text", String)
    lines = [Line(f"{name}/text", Nothing()) for name in names]
    for line in lines:
        outlet.add(line)
    return outlet, lines


def test_only_robots_that_are_heard_are_put_on() -> None:
    bus = CountingBus()
    bus.subscribe("r2/text", 8)
    outlet, lines = an_outlet(bus, "r1", "r2", "r3")

    outlet.declare_some()
    outlet.put(lines, [b"1"] * 3)
    outlet.declare_some()
    outlet.put(lines, [b"2"] * 3)

    assert bus.put_on == ["r1/text", "r2/text", "r3/text", "r2/text"]


def test_nothing_is_put_once_all_have_ceased_to_listen() -> None:
    bus = CountingBus()
    heard = bus.subscribe("r1/text")
    outlet, lines = an_outlet(bus, "r1")

    outlet.declare_some()
    heard.close()
    outlet.put(lines, [b"1"])

    assert bus.put_on == []


def test_robot_is_heard_by_who_comes_while_others_listen() -> None:
    bus = CountingBus()
    bus.subscribe("r1/text", 8)
    outlet, lines = an_outlet(bus, "r1", "r2")
    outlet.declare_some()
    outlet.put(lines, [b"1"] * 2)
    outlet.declare_some()

    late = bus.subscribe("r2/text", 8)
    outlet.put(lines, [b"2"] * 2)
    outlet.declare_some()
    outlet.put(lines, [b"3"] * 2)

    assert [sample.payload for sample in late.take()] == [b"3"]
