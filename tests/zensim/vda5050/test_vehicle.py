"""A vehicle and its reports, against what each version of the standard requires."""

import json
from collections.abc import Mapping
from typing import Any

import msgspec
import pytest

from tests.zensim.vda5050.orders import action, edge, header, line, node, order, write
from zensim.vda5050.factsheet import make_factsheet
from zensim.vda5050.path_follower import ACKERMANN, VehicleLimits
from zensim.vda5050.vda_messages import Major
from zensim.vda5050.vehicle import Vehicle, VehiclePose, VehicleRecord
from zensim.vda5050.vehicle_reports import (
    VehicleBody,
    VehicleMotion,
    report_connection,
    report_state,
    report_visualization,
)
from zensim.vda5050.vehicle_settings import ActionSettings, BatterySettings, FleetSettings

HERE = VehiclePose()
COMMON = {
    "orderId": str,
    "orderUpdateId": int,
    "lastNodeId": str,
    "lastNodeSequenceId": int,
    "driving": bool,
    "operatingMode": str,
    "nodeStates": list,
    "edgeStates": list,
    "actionStates": list,
    "errors": list,
    "safetyState": dict,
}
STATES: Mapping[Major, Mapping[str, type]] = {
    2: COMMON | {"batteryState": dict},
    3: COMMON | {"instantActionStates": list, "powerSupply": dict},
}
"""Fields of a state that each version requires, with their types."""


class Loads:
    """Loads that can be picked."""

    def __init__(self, *names: str) -> None:
        self.names = set(names)

    def attach(self, vehicle: str, load: str) -> str:  # noqa: ARG002
        """See `Cargo`."""
        return "" if load in self.names else f"there is no {load}"

    def detach(self, vehicle: str, load: str) -> str:  # noqa: ARG002
        """See `Cargo`."""
        return ""


def make(major: Major = 2, **fields: Any) -> Vehicle:  # noqa: ANN401
    settings = FleetSettings(**fields)
    cargo = Loads("box")
    return Vehicle("r1", major=major, map_id="default", settings=settings, cargo=cargo, serial="r1")


def instant(vehicle: Vehicle, name: str, number: str = "i", **parameters: object) -> str:
    """Do an instant action; return what became of it."""
    given = header(vehicle.major) | {"actions": [action(name, number, "NONE", **parameters)]}
    vehicle.take_instant_actions(write(given), HERE)
    return vehicle.record.instant[-1].status


def list_errors(vehicle: Vehicle) -> list[tuple[str, str]]:
    found = report_state(vehicle, VehicleMotion())["errors"]
    return [(one["errorType"], one["errorLevel"]) for one in found]


@pytest.mark.parametrize("major", [2, 3])
def test_state_has_what_its_version_requires(major: Major) -> None:
    vehicle = make(major)
    points = [{"x": 0, "y": 0}, {"x": 1, "y": 0}]
    curve = {"degree": 1, "knotVector": [0, 0, 1, 1], "controlPoints": points}
    nodes = [node(0, (0, 0)), node(2, (1, 0), action("wait", "a"), theta=0.5)]
    vehicle.take_order(write(order(nodes, [edge(1, trajectory=curve)], major=major)), HERE)
    instant(vehicle, "stateRequest")

    state = json.loads(msgspec.json.encode(report_state(vehicle, VehicleMotion())))

    assert {name: type(state[name]) for name in STATES[major]} == dict(STATES[major])
    assert set(state["nodeStates"][0]) == {"nodeId", "sequenceId", "released", "nodePosition"}
    assert state["edgeStates"][0]["trajectory"]["controlPoints"][1]["x"] == 1.0
    assert state["actionStates"][0]["actionStatus"] == "WAITING"
    assert len(state["actionStates"]) == (2 if major == 2 else 1)


@pytest.mark.parametrize("major", [2, 3])
@pytest.mark.parametrize(
    ("limits", "expected"),
    [
        (VehicleLimits(), ("DIFF", "DIFFERENTIAL")),
        (VehicleLimits(is_sideways=True), ("OMNI", "OMNIDIRECTIONAL")),
        (VehicleLimits(curvature=1.0, steering=ACKERMANN), ("THREEWHEEL", "THREE_WHEEL")),
    ],
)
def test_factsheet_describes_the_model(
    major: Major, limits: VehicleLimits, expected: tuple[str, str]
) -> None:
    body = VehicleBody(1.2, 0.8, 0.3, limits, "truck")

    sheet = make_factsheet(major, body, FleetSettings())

    kinds = {"agvKinematic", "mobileRobotKinematics"} & set(sheet["typeSpecification"])
    assert sheet["typeSpecification"][kinds.pop()] == expected[major - 2]
    assert sheet["physicalParameters"]["length"] == 1.2
    actions = sheet["protocolFeatures"]["mobileRobotActions" if major == 3 else "agvActions"]
    assert {"pick", "drop", "cancelOrder"} <= {one["actionType"] for one in actions}


def test_messages_have_the_names_of_their_version() -> None:
    assert report_connection(2, "CONNECTION_BROKEN") == {"connectionState": "CONNECTIONBROKEN"}
    assert report_connection(3, "CONNECTION_BROKEN") == {"connectionState": "CONNECTION_BROKEN"}
    assert "agvPosition" in report_visualization(make(), VehicleMotion(), 4)
    assert report_visualization(make(3), VehicleMotion(), 4)["referenceStateHeaderId"] == 4


def test_pick_and_drop_change_the_load() -> None:
    vehicle = make()
    actions = (action("pick", "a", loadId="box"), action("drop", "b"), action("drop", "c"))
    vehicle.take_order(write(order([node(0, (0, 0), *actions)], [])), HERE)

    loads = []
    for _ in range(8):
        vehicle.step(2.0, 0.0, is_still=True)
        loads.append(vehicle.record.load)

    assert loads[2] == "box"
    assert loads[-1] is None
    assert [one.status for one in vehicle.progress.actions] == ["FINISHED", "FINISHED", "FAILED"]
    assert list_errors(vehicle) == [("actionError", "WARNING")]


@pytest.mark.parametrize(
    ("given", "status"),
    [
        ({}, "FINISHED"),
        ({"duration": "2"}, "FINISHED"),
        ({"duration": -1}, "FAILED"),
        ({"duration": "x"}, "FAILED"),
        ({"duration": [1]}, "FAILED"),
    ],
)
def test_wait_of_no_duration_fails(given: dict[str, Any], status: str) -> None:
    vehicle = make()
    vehicle.take_order(write(order([node(0, (0, 0), action("wait", "a", **given))], [])), HERE)

    for _ in range(3):
        vehicle.step(2.0, 0.0, is_still=True)

    (found,) = vehicle.progress.actions
    assert found.status == status
    assert ("duration" in found.result) == (status == "FAILED")


def test_vehicle_is_paused_and_goes_on() -> None:
    vehicle = make()

    assert instant(vehicle, "startPause", "a") == "RUNNING"
    assert vehicle.is_waiting
    vehicle.step(0.1, 0.0, is_still=True)
    assert vehicle.record.instant[0].status == "FINISHED"
    assert instant(vehicle, "stopPause", "b") == "FINISHED"
    assert not vehicle.is_waiting


@pytest.mark.parametrize(("major", "mode"), [(2, "AUTOMATIC"), (3, "INTERVENED")])
def test_vehicle_that_somebody_drives_is_paused_until_it_may_go_on(major: Major, mode: str) -> None:
    vehicle = make(major)
    vehicle.take_over()
    idle = report_state(vehicle, VehicleMotion())["operatingMode"]
    vehicle.take_order(write(line((0, 0), (2, 0), major=major)), HERE)

    vehicle.take_over()
    taken = report_state(vehicle, VehicleMotion())

    assert idle == "AUTOMATIC"
    assert (taken["operatingMode"], taken["paused"], vehicle.is_waiting) == (mode, True, True)
    assert instant(vehicle, "stopPause", "b") == "FINISHED"
    assert report_state(vehicle, VehicleMotion())["operatingMode"] == "AUTOMATIC"
    assert not vehicle.is_waiting


@pytest.mark.parametrize("major", [2, 3])
def test_instant_actions_that_cannot_be_done_fail_with_an_error(major: Major) -> None:
    vehicle = make(major)

    assert instant(vehicle, "fly", "a") == "FAILED"
    assert instant(vehicle, "cancelOrder", "b") == "FAILED"
    assert instant(vehicle, "initPosition", "c", x=99, y=0, mapId="default") == "FAILED"
    names = {one for one, _ in list_errors(vehicle)}
    assert names == (
        {"instantActionError", "noOrderToCancel"}
        if major == 2
        else {"INVALID_INSTANT_ACTION", "NO_ORDER_TO_CANCEL"}
    )


def test_instant_action_is_done_once() -> None:
    vehicle = make()
    given = write(header() | {"actions": [action("startPause", "a", "NONE")] * 2})

    vehicle.take_instant_actions(given, HERE)
    instant(vehicle, "stopPause", "b")
    vehicle.take_instant_actions(given, HERE)

    assert not vehicle.record.is_paused


def test_actions_of_2_0_have_another_name() -> None:
    vehicle = make()
    given = header() | {"instantActions": [action("startPause", "a", "NONE")]}

    vehicle.take_instant_actions(write(given), HERE)

    assert vehicle.record.is_paused


def test_init_position_sets_the_last_node() -> None:
    vehicle = make()

    assert instant(vehicle, "initPosition", "a", x=0.1, y=0, mapId="default", lastNodeId="n7") == (
        "FINISHED"
    )
    assert vehicle.progress.last_node_id == "n7"


def test_trigger_ends_the_wait_for_it() -> None:
    vehicle = make(3)
    waits = action("waitForTrigger", "a", triggerType=["FLEET_CONTROL"])
    vehicle.take_order(write(order([node(0, (0, 0), waits)], [], major=3)), HERE)
    for _ in range(5):
        vehicle.step(100.0, 0.0, is_still=True)

    waiting = vehicle.progress.actions[0].status
    instant(vehicle, "trigger")
    vehicle.step(0.1, 0.0, is_still=True)

    assert (waiting, vehicle.progress.actions[0].status) == ("RUNNING", "FINISHED")


def test_battery_drains_warns_and_is_charged() -> None:
    battery = BatterySettings(at_start=21.0, per_hour=0.0, per_km=1000.0, charged_per_minute=60.0)
    actions = {"charge": ActionSettings("charge", until_percent=30.0)}
    vehicle = make(battery=battery, actions=actions)

    vehicle.step(1.0, 2.0, is_still=False)
    low = list_errors(vehicle)
    vehicle.take_order(write(order([node(0, (0, 0), action("charge", "a"))], [])), HERE)
    vehicle.step(0.1, 0.0, is_still=True)
    is_charging = vehicle.record.is_charging
    for _ in range(14):
        vehicle.step(1.0, 0.0, is_still=True)

    assert low == [("lowBattery", "WARNING")]
    assert is_charging
    assert not vehicle.record.is_charging
    assert vehicle.progress.actions[0].status == "FINISHED"
    assert list_errors(vehicle) == []


def test_empty_battery_stops_the_vehicle() -> None:
    vehicle = make(battery=BatterySettings(at_start=1.0, per_km=1000.0))

    vehicle.step(1.0, 5.0, is_still=False)

    assert vehicle.is_stuck
    assert ("emptyBattery", "FATAL") in list_errors(vehicle)
    low, empty = vehicle.errors
    assert "20 %" in low.text
    assert "20 %" not in empty.text


def test_record_outlives_a_vehicle() -> None:
    vehicle = make()
    nodes = [node(0, (0, 0), action("wait", "a", duration=2)), node(2, (1, 0))]
    vehicle.take_order(write(order(nodes, [edge(1)])), HERE)
    vehicle.step(0.1, 0.0, is_still=True)

    kept = msgspec.json.decode(msgspec.json.encode(vehicle.record), type=VehicleRecord)
    (other := make()).restore(kept)
    other.take_order(write(order(nodes, [edge(1)])), HERE)

    assert report_state(other, VehicleMotion()) == report_state(vehicle, VehicleMotion())
    assert other.progress.actions[0].left_s == 2.0


@pytest.mark.parametrize("key", ["serialNumber", "manufacturer"])
def test_order_for_another_vehicle_is_refused(key: str) -> None:
    vehicle, given = make(), line((0, 0), (1, 0))

    vehicle.take_order(write(given | {key: "other"}), HERE)

    assert list_errors(vehicle) == [("validationError", "WARNING")]
    assert "'other'" in vehicle.errors[0].text
    assert repr(given[key]) in vehicle.errors[0].text
    assert vehicle.progress.is_idle
    vehicle.take_order(write({name: one for name, one in given.items() if name != key}), HERE)
    assert not vehicle.progress.is_idle


@pytest.mark.parametrize("key", ["serialNumber", "manufacturer"])
def test_instant_actions_for_another_vehicle_are_refused(key: str) -> None:
    vehicle = make()
    given = header() | {"actions": [action("startPause", "p", blocking="NONE")]}

    vehicle.take_instant_actions(write(given | {key: "other"}), HERE)

    assert list_errors(vehicle) == [("validationError", "WARNING")]
    assert "'other'" in vehicle.errors[0].text
    assert not vehicle.record.instant
    vehicle.take_instant_actions(write(given), HERE)
    assert [one.action.action_id for one in vehicle.record.instant] == ["p"]


def test_accepted_order_ends_the_errors_of_others() -> None:
    vehicle = make()
    vehicle.take_order(b"{}", HERE)
    vehicle.take_order(write(line((9, 9), (1, 0))), HERE)
    rejected = list_errors(vehicle)

    vehicle.take_order(write(line((0, 0), (1, 0))), HERE)

    assert rejected == [("validationError", "WARNING"), ("noRouteError", "WARNING")]
    assert list_errors(vehicle) == []
