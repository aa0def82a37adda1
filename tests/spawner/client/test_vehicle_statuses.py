"""What vehicles do, as programs say it."""

from tests.fakes import ManualClock
from zensim.proto.messages.vehicle_messages import FleetStatus, VehicleStatus
from zensim.spawner.client.vehicle_statuses import STALE_S, VehicleStatuses


def test_programs_of_parts_of_a_fleet_are_one_list() -> None:
    statuses = VehicleStatuses()

    statuses.receive(FleetStatus((VehicleStatus("r1", "o1"),)))
    statuses.receive(FleetStatus((VehicleStatus("r2", "o2"),)))
    statuses.receive(FleetStatus((VehicleStatus("r1", "o3"),)))

    assert {name: one.order for name, one in statuses.read().items()} == {"r1": "o3", "r2": "o2"}


def test_status_does_not_count_when_its_program_is_silent() -> None:
    clock = ManualClock()
    statuses = VehicleStatuses(clock)
    statuses.receive(FleetStatus((VehicleStatus("r1"), VehicleStatus("r2"))))
    clock.sleep(STALE_S)
    statuses.receive(FleetStatus((VehicleStatus("r2"),)))
    clock.sleep(0.1)

    assert statuses.find("r1") is None
    assert statuses.find("r2") is not None
    assert list(statuses.read()) == ["r2"]
