"""Messages that vehicles send: state, visualization, connection and factsheet of both versions."""

import math
from collections.abc import Sequence
from typing import Any, Final, NamedTuple, TypeAlias

import msgspec
import numpy as np

from zensim.proto.messages.vehicle_messages import MAX_ROUTE_POINTS, VehicleStatus
from zensim.proto.se3 import FloatArray
from zensim.vda5050.order_progress import ActionState
from zensim.vda5050.path_follower import VehicleLimits
from zensim.vda5050.vda_messages import Edge, Major, Node
from zensim.vda5050.vehicle import InstantState, Vehicle, VehiclePose

Message: TypeAlias = dict[str, Any]
STATE_PERIOD_S: Final = 30.0
MIN_STATE_PERIOD_S: Final = 0.05
INSTANT_ACTIONS: Final = (
    "cancelOrder",
    "startPause",
    "stopPause",
    "stateRequest",
    "factsheetRequest",
    "logReport",
)


class VehicleMotion(NamedTuple):
    """How a vehicle moves now."""

    pose: VehiclePose = VehiclePose()
    forward: float = 0.0
    """[m/s], as `left`."""
    left: float = 0.0
    turn: float = 0.0
    """[rad/s]."""
    is_driving: bool = False
    since_node_m: float = 0.0
    is_field_violated: bool = False


class VehicleBody(NamedTuple):
    """Size of a vehicle [m], and what it can do."""

    length: float
    width: float
    height: float
    limits: VehicleLimits
    model: str = ""


def report_state(vehicle: Vehicle, motion: VehicleMotion) -> Message:
    """Make the state without its header."""
    record, major = vehicle.record, vehicle.major
    progress = record.progress
    instant = [_report_action(one, major) for one in record.instant]
    actions = [_report_action(one, major) for one in progress.actions]
    state: Message = {
        "orderId": progress.order_id,
        "orderUpdateId": progress.update_id,
        "lastNodeId": progress.last_node_id,
        "lastNodeSequenceId": progress.last_sequence_id,
        "driving": motion.is_driving,
        "paused": record.is_paused,
        "newBaseRequest": len(progress.nodes) > progress.base and progress.base <= 1,
        "distanceSinceLastNode": round(motion.since_node_m, 3),
        "operatingMode": _find_mode(vehicle),
        "nodeStates": [_report_node(one) for one in progress.nodes],
        "edgeStates": [_report_edge(one) for one in progress.edges],
        "loads": [] if record.load is None else [{"loadId": record.load}],
        "errors": _report_errors(vehicle),
        "information": [],
        "velocity": _report_velocity(motion),
    }
    charge, is_violated = round(record.charge, 2), motion.is_field_violated
    if major == 3:  # noqa: PLR2004
        return state | {
            "actionStates": actions,
            "instantActionStates": instant,
            "mobileRobotPosition": _report_position(vehicle, motion),
            "powerSupply": {"stateOfCharge": charge, "charging": record.is_charging},
            "safetyState": {"activeEmergencyStop": "NONE", "fieldViolation": is_violated},
        }
    return state | {
        "actionStates": actions + instant,
        "agvPosition": _report_position(vehicle, motion),
        "batteryState": {"batteryCharge": charge, "charging": record.is_charging},
        "safetyState": {"eStop": "NONE", "fieldViolation": is_violated},
    }


def _find_mode(vehicle: Vehicle) -> str:
    """Find the mode; 2.1 has none in which a person drives and the order is kept."""
    is_intervened = vehicle.is_manual and vehicle.major == 3  # noqa: PLR2004
    return "INTERVENED" if is_intervened else "AUTOMATIC"


def report_status(vehicle: Vehicle, motion: VehicleMotion, route: FloatArray) -> VehicleStatus:
    """Make what the page and `zensim top` show.

    Args:
        vehicle: The vehicle.
        motion: How it moves.
        route: Points from the vehicle to the end of its route [m], (k, 2).
    """
    progress = vehicle.progress
    count = min(len(route), MAX_ROUTE_POINTS)
    shown = route[np.linspace(0, len(route) - 1, count).round().astype(int)] if count else route
    return VehicleStatus(
        entity=vehicle.name,
        order=progress.order_id,
        task=_find_task(vehicle, motion),
        last_node=progress.last_node_id,
        goal=progress.nodes[progress.base - 1].node_id if progress.base else "",
        battery_percent=vehicle.record.charge,
        errors=tuple(f"{one.kind.name(vehicle.major)}: {one.text}" for one in vehicle.errors),
        route=shown.astype("<f4").tobytes(),
    )


def _find_task(vehicle: Vehicle, motion: VehicleMotion) -> str:
    if vehicle.record.is_paused:
        return "paused"
    if motion.is_driving:
        return "driving"
    if vehicle.record.is_charging:
        return "charging"
    return "idle" if vehicle.progress.is_idle else "waiting"


def report_visualization(vehicle: Vehicle, motion: VehicleMotion, state_number: int) -> Message:
    """Make the visualization without its header.

    Args:
        vehicle: The vehicle.
        motion: How it moves.
        state_number: headerId of its last state.
    """
    where = _report_position(vehicle, motion)
    found: Message = {"velocity": _report_velocity(motion)}
    if vehicle.major == 3:  # noqa: PLR2004
        return found | {"mobileRobotPosition": where, "referenceStateHeaderId": state_number}
    return found | {"agvPosition": where}


def report_connection(major: Major, state: str) -> Message:
    """Make the connection without its header; `CONNECTION_BROKEN` has another name in 2.1."""
    return {"connectionState": state.replace("_", "") if major == 2 else state}  # noqa: PLR2004


def _report_velocity(motion: VehicleMotion) -> Message:
    numbers = (motion.forward, motion.left, motion.turn)
    return {name: round(one, 4) for name, one in zip(("vx", "vy", "omega"), numbers, strict=True)}


def _report_position(vehicle: Vehicle, motion: VehicleMotion) -> Message:
    pose = motion.pose
    known = "localized" if vehicle.major == 3 else "positionInitialized"  # noqa: PLR2004
    theta = math.remainder(pose.yaw, 2.0 * math.pi)
    return {
        "x": round(pose.x, 4),
        "y": round(pose.y, 4),
        "theta": round(max(-3.14159, min(3.14159, theta)), 5),
        "mapId": vehicle.map_id,
        known: True,
    }


def _report_node(node: Node) -> Message:
    found: Message = {
        "nodeId": node.node_id,
        "sequenceId": node.sequence_id,
        "released": node.released,
    }
    place = node.node_position
    if place is not None:
        found["nodePosition"] = {"x": place.x, "y": place.y, "mapId": place.map_id}
        if place.theta is not None:
            found["nodePosition"]["theta"] = place.theta
    return found


def _report_edge(edge: Edge) -> Message:
    found: Message = {
        "edgeId": edge.edge_id,
        "sequenceId": edge.sequence_id,
        "released": edge.released,
    }
    if edge.trajectory is not None and edge.trajectory.knot_vector:
        found["trajectory"] = msgspec.to_builtins(edge.trajectory)
    return found


def _report_action(one: ActionState | InstantState, major: Major) -> Message:
    name = "actionResult" if major == 3 else "resultDescription"  # noqa: PLR2004
    return {
        "actionId": one.action.action_id,
        "actionType": one.action.action_type,
        "actionStatus": one.status,
        name: one.result,
    }


def _report_errors(vehicle: Vehicle) -> Sequence[Message]:
    return [
        {
            "errorType": one.kind.name(vehicle.major),
            "errorLevel": one.kind.level(vehicle.major),
            "errorDescription": one.text,
            "errorReferences": [
                {"referenceKey": key, "referenceValue": value} for key, value in one.references
            ],
        }
        for one in vehicle.errors
    ]
