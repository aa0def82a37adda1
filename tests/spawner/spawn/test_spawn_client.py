"""Payloads, resources, bonds and fleets."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes import MemoryBus
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.entity_messages import EntityFilters, EntityState
from zensim.proto.messages.result_messages import Result, ResultCode, ServiceError, SpawnCode
from zensim.proto.messages.spawn_messages import (
    MAX_SPAWNS,
    NOT_SPAWNED_PREFIX,
    Resource,
    SpawnEntitiesOrder,
    SpawnEntitiesResponse,
    SpawnEntityOrder,
    SpawnEntityReport,
    SpawnResult,
)
from zensim.proto.messages.standard_messages import Pose, Quaternion
from zensim.proto.se3 import from_rpy
from zensim.spawner.client.sim_client import SimClient
from zensim.spawner.spawn import spawn_client
from zensim.spawner.spawn.description_xml import DescriptionError
from zensim.spawner.spawn.spawn_client import (
    SpawnOutcome,
    hold_bond,
    make_bond_name,
    make_resource,
    read_payload,
    spawn_bonded,
    spawn_fleet,
    wait_for_entity,
)
from zensim.spawner.spawn.spawn_poses import RobotPlacement, make_pose

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus


def refusal(code: ResultCode) -> ServiceError:
    return ServiceError("service", code, code.name, "no")


class FailingClient(SimClient):
    """Raises each of the failures once, then succeeds."""

    def __init__(self, *failures: Exception) -> None:
        super().__init__(cast("Bus", MemoryBus()))
        self.failures = list(failures)
        self.deleted: list[str] = []

    def spawn(self, order: SpawnEntityOrder) -> SpawnEntityReport:
        self._fail()
        return SpawnEntityReport(entity_name=order.name)

    def entity_state(self, entity: str, reference_frame: str = "") -> EntityState:
        del entity, reference_frame
        self._fail()
        return EntityState()

    def entities(self, filters: EntityFilters | None = None) -> tuple[str, ...]:
        del filters
        return ("r1",)

    def delete(self, entity: str) -> None:
        self._fail()
        self.deleted.append(entity)

    def _fail(self) -> None:
        if self.failures:
            raise self.failures.pop(0)


def test_bond_names_differ() -> None:
    assert make_bond_name() != make_bond_name()


def test_bonded_spawn_is_retried_until_the_token_is_seen() -> None:
    early = refusal(ResultCode.INCORRECT_STATE)

    report = spawn_bonded(FailingClient(early, early), SpawnEntityOrder("r1", bond="b"))

    assert report.entity_name == "r1"


@pytest.mark.parametrize(
    ("code", "bond"), [(ResultCode.INCORRECT_STATE, ""), (ResultCode.OPERATION_FAILED, "b")]
)
def test_bonded_spawn_is_not_retried_after_another_refusal(code: ResultCode, bond: str) -> None:
    client = FailingClient(refusal(code))

    with pytest.raises(ServiceError):
        spawn_bonded(client, SpawnEntityOrder("r1", bond=bond))


def test_bond_deletes_the_entity_at_its_end() -> None:
    client = FailingClient()

    assert hold_bond(client, "r1", lambda: True)

    assert client.deleted == ["r1"]


def test_bond_accepts_that_the_entity_was_deleted() -> None:
    assert not hold_bond(FailingClient(refusal(ResultCode.NOT_FOUND)), "r1", lambda: True)


def test_bond_ends_when_the_entity_is_deleted(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(spawn_client, "CHECK_PERIOD_S", 0.0)
    client = FailingClient(NoServer("away"), TimeoutError("away"), refusal(ResultCode.NOT_FOUND))

    assert not hold_bond(client, "r1", lambda: False)


def test_waiting_for_an_entity_has_a_timeout() -> None:
    wait_for_entity(FailingClient(), "r1", 0.0)

    with pytest.raises(TimeoutError, match="r9"):
        wait_for_entity(FailingClient(), "r9", 0.1)


DRIVEN = (
    '<robot name="r"><link name="base"/><gazebo>'
    '<plugin name="d" filename="libgazebo_ros_diff_drive.so"/></gazebo></robot>'
)
angles = st.floats(-3.0, 3.0)


class RecordingClient(SimClient):
    """Records orders; refuses the given names."""

    def __init__(self, *refused: str) -> None:
        super().__init__(cast("Bus", MemoryBus()))
        self.orders: list[SpawnEntitiesOrder] = []
        self._refused = refused

    def spawn_all(self, order: SpawnEntitiesOrder) -> SpawnEntitiesResponse:
        self.orders.append(order)
        taken = SpawnResult(Result(SpawnCode.NAME_NOT_UNIQUE, "taken"))
        return SpawnEntitiesResponse(
            results=tuple(
                taken if one.name in self._refused else SpawnResult(entity_name=one.name)
                for one in order.spawn_requests
            )
        )


def test_payload_is_read_from_a_file(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_text("<robot/>", encoding="utf-8")

    assert read_payload(str(file)).text == "<robot/>"


def test_payload_is_read_from_a_built_in_model() -> None:
    assert '<robot name="box_bot">' in read_payload("box_bot").text


def test_payload_has_no_text_for_an_unknown_name() -> None:
    assert read_payload("tank").text == ""


@pytest.mark.parametrize("model", ["nowhere/r.urdf", "r.urdf", "", "a b"])
def test_payload_is_refused_without_a_file(model: str) -> None:
    with pytest.raises(FileNotFoundError, match=f"{model}'$"):
        read_payload(model)


def test_payload_is_refused_for_a_binary_file(tmp_path: Path) -> None:
    file = tmp_path / "r.urdf"
    file.write_bytes(b"\xff\xfe\x00")

    with pytest.raises(DescriptionError):
        read_payload(str(file))


def test_resource_is_the_name_without_a_text() -> None:
    assert make_resource("tank", "", "r1") == Resource(uri="tank")


def test_resource_is_the_unchanged_text_without_a_namespace() -> None:
    assert make_resource("r", DRIVEN, "") == Resource(resource_string=DRIVEN)


def test_resource_is_the_text_with_its_namespace() -> None:
    text = make_resource("r", DRIVEN, "team/r1").resource_string

    assert "<namespace>/team/r1</namespace>" in text
    assert "<remapping>/tf:=/team/r1/tf</remapping>" in text


def test_resource_is_refused_for_another_root_element() -> None:
    with pytest.raises(DescriptionError, match="<html>"):
        make_resource("r", "<html/>", "r1")


def test_pose_has_the_given_position() -> None:
    assert make_pose((1.0, 2.0, 3.0)).position.z == 3.0
    assert make_pose((0.0, 0.0, 0.0)) == Pose()


@given(angles, angles, angles)
def test_pose_has_the_angles_of_urdf(roll: float, pitch: float, yaw: float) -> None:
    q = make_pose((0.0, 0.0, 0.0), (roll, pitch, yaw)).orientation

    assert [q.x, q.y, q.z, q.w] == pytest.approx(from_rpy(roll, pitch, yaw), abs=1e-12)


def test_fleet_is_one_request_with_a_namespace_each() -> None:
    client = RecordingClient()
    placements = [RobotPlacement("r0", 1.0, 2.0), RobotPlacement("r1", 3.0, 4.0, math.pi)]

    outcomes = spawn_fleet(client, "box_bot", placements, lambda _: None)

    assert outcomes == [SpawnOutcome("r0", ResultCode.OK), SpawnOutcome("r1", ResultCode.OK)]
    (order,) = client.orders
    assert (order.atomic, order.common.snap_to_ground) == (True, True)
    assert [(one.name, one.entity_namespace) for one in order.spawn_requests] == [
        ("r0", "r0"),
        ("r1", "r1"),
    ]
    pose = order.spawn_requests[1].initial_pose.pose
    assert (pose.position.x, pose.position.y) == (3.0, 4.0)
    assert np.allclose([pose.orientation.z, pose.orientation.w], [1.0, 0.0])


def test_fleet_shares_a_description_without_namespace() -> None:
    client = RecordingClient()

    spawn_fleet(client, "box_bot", [RobotPlacement("r0", 0.0, 0.0)], lambda _: None)

    (order,) = client.orders
    assert all(one.entity_resource == Resource() for one in order.spawn_requests)
    assert "<namespace>" not in order.common.entity_resource.resource_string
    assert "libgazebo_ros_diff_drive.so" in order.common.entity_resource.resource_string


def test_fleet_returns_an_outcome_per_robot() -> None:
    client = RecordingClient("r1")
    done: list[str] = []

    outcomes = spawn_fleet(
        client,
        "box_bot",
        [RobotPlacement(f"r{i}", 0.0, 0.0) for i in range(3)],
        lambda outcome: done.append(outcome.name),
    )

    assert [outcome.code for outcome in outcomes] == [1, SpawnCode.NAME_NOT_UNIQUE, 1]
    assert outcomes[1].message == "NAME_NOT_UNIQUE (101): taken"
    assert done == ["r0", "r1", "r2"]


def test_fleet_of_more_than_one_request_is_split() -> None:
    client = RecordingClient()
    placements = [RobotPlacement(f"r{i}", 0.0, 0.0) for i in range(2 * MAX_SPAWNS + 1)]

    outcomes = spawn_fleet(client, "box_bot", placements, lambda _: None)

    assert [one.name for one in outcomes] == [one.name for one in placements]
    counts = [len(order.spawn_requests) for order in client.orders]
    assert counts == [MAX_SPAWNS, MAX_SPAWNS, 1]


def test_fleet_ends_at_the_first_request_that_is_refused() -> None:
    client = RecordingClient(f"r{MAX_SPAWNS}")
    placements = [RobotPlacement(f"r{i}", 0.0, 0.0) for i in range(2 * MAX_SPAWNS + 1)]

    outcomes = spawn_fleet(client, "box_bot", placements, lambda _: None)

    assert len(client.orders) == 2
    assert len(outcomes) == len(placements)
    assert outcomes[-1].code == ResultCode.OPERATION_FAILED
    assert NOT_SPAWNED_PREFIX in outcomes[-1].message


class EndingClient(RecordingClient):
    """Replies to the first request only."""

    def __init__(self, error: Exception) -> None:
        super().__init__()
        self._error = error

    def spawn_all(self, order: SpawnEntitiesOrder) -> SpawnEntitiesResponse:
        if self.orders:
            raise self._error
        return super().spawn_all(order)


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (TimeoutError("no reply"), ResultCode.OPERATION_FAILED),
        (NoServer("gone"), ResultCode.OPERATION_FAILED),
        (ServiceError("spawn_entities", 107, "INVALID", "no"), 107),
    ],
)
def test_fleet_keeps_what_was_spawned_when_a_later_request_fails(
    error: Exception, code: int
) -> None:
    placements = [RobotPlacement(f"r{i}", 0.0, 0.0) for i in range(2 * MAX_SPAWNS + 1)]

    outcomes = spawn_fleet(EndingClient(error), "box_bot", placements, lambda _: None)

    expected = [ResultCode.OK] * MAX_SPAWNS + [code] * (MAX_SPAWNS + 1)
    assert [one.code for one in outcomes] == expected
    assert [one.name for one in outcomes] == [one.name for one in placements]


def test_fleet_fails_without_a_server() -> None:
    client = SimClient(cast("Bus", MemoryBus()))

    with pytest.raises(NoServer):
        spawn_fleet(client, "box_bot", [RobotPlacement("r0", 0.0, 0.0)], lambda _: None)


def test_pose_without_angles_is_the_identity() -> None:
    assert make_pose((0.0, 0.0, 0.0)).orientation == Quaternion()
