"""What `zensim top` reads where the server has ceased to reply."""

from typing import Any

import pytest

from tests.foxglove.fake_bus import FakeBus
from tests.spawner.top.readings import MODELS, a_snapshot
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.vehicle_messages import FleetStatus, VehicleStatus
from zensim.proto.network_protocols import Sample
from zensim.proto.topic_catalog import SNAPSHOT, VEHICLES
from zensim.spawner.client import world_follower
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.top.fleet_figures import list_robot_rows
from zensim.spawner.top.fleet_source import FleetSource

WORLD = "default"


class SuspendedBus(FakeBus):
    """A session whose server may be suspended; keeps how long calls would wait for it."""

    def __init__(self) -> None:
        super().__init__()
        self.models = MODELS
        self.is_suspended = False
        self.waits_s: list[float] = []

    def get(self, key: str, timeout_s: float = 1.0) -> list[Sample]:
        self.waits_s.append(timeout_s)
        return [] if self.is_suspended else super().get(key)

    def call(self, *given: Any, **options: Any) -> Any:  # noqa: ANN401
        self.waits_s.append(options["timeout_s"])
        if self.is_suspended:
            raise TimeoutError("no reply")
        return super().call(*given)


@pytest.fixture
def bus() -> SuspendedBus:
    bus = SuspendedBus()
    payload = encode(a_snapshot(), Format.MSGPACK)
    bus.stored = [Sample(SNAPSHOT.key(WORLD), payload, SNAPSHOT.encoding)]
    return bus


def test_reading_of_a_suspended_server_takes_a_second_at_most(bus: SuspendedBus) -> None:
    source = FleetSource(SimClient(bus.as_bus, WORLD))
    first = source.read()
    bus.is_suspended = True
    bus.waits_s.clear()

    last = source.read()

    assert first.snapshot is not None
    assert sum(bus.waits_s) <= 1.0
    assert (last.snapshot, last.models) == (None, MODELS)


def test_server_that_replies_to_no_call_is_not_waited_for_long(bus: SuspendedBus) -> None:
    source = FleetSource(SimClient(bus.as_bus, WORLD))

    source.read()

    assert max(bus.waits_s) <= world_follower.TIMEOUT_S


def test_robots_that_are_vehicles_have_their_order(bus: SuspendedBus) -> None:
    source = FleetSource(SimClient(bus.as_bus, WORLD))
    status = VehicleStatus("r1", "o7", "driving", "n1", "n4", 81.6)
    bus.publish(VEHICLES.key(WORLD), encode(FleetStatus((status,)), Format.MSGPACK))

    rows = list_robot_rows(source.read())

    assert {row.name: row.order for row in rows}["r1"] == "o7 to n4, driving, 82 %"
    assert {row.order for row in rows if row.name != "r1"} == {None}
