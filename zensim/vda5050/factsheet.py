"""The factsheet of a vehicle, made from its model and the settings."""

import math
from typing import Final

from zensim.vda5050.path_follower import YAW_RATE
from zensim.vda5050.vda_messages import MAX_ITEMS, MAX_MESSAGE_BYTES, Major
from zensim.vda5050.vehicle_reports import (
    INSTANT_ACTIONS,
    MIN_STATE_PERIOD_S,
    STATE_PERIOD_S,
    Message,
    VehicleBody,
)
from zensim.vda5050.vehicle_settings import FleetSettings

KINEMATICS: Final = {
    2: ("DIFF", "OMNI", "THREEWHEEL"),
    3: ("DIFFERENTIAL", "OMNIDIRECTIONAL", "THREE_WHEEL"),
}
ARRAYS: Final = ("order.nodes", "order.edges", "node.actions", "edge.actions", "instantActions")


def make_factsheet(major: Major, body: VehicleBody, settings: FleetSettings) -> Message:
    """Make the factsheet without its header."""
    is_3 = major == 3  # noqa: PLR2004
    return {
        "typeSpecification": _describe_type(major, body),
        "physicalParameters": _describe_physics(body, is_3=is_3),
        "protocolLimits": _describe_limits(settings, is_3=is_3),
        "protocolFeatures": _describe_features(settings, is_3=is_3),
        "mobileRobotGeometry" if is_3 else "agvGeometry": {},
        "loadSpecification": {"loadPositions": ["top"]},
    }


def _describe_type(major: Major, body: VehicleBody) -> Message:
    limits, names = body.limits, KINEMATICS[major]
    is_steered = limits.steering != YAW_RATE or not math.isinf(limits.curvature)
    kinematics = names[1] if limits.is_sideways else names[2] if is_steered else names[0]
    if major == 3:  # noqa: PLR2004
        kinds = ("mobileRobotKinematics", "mobileRobotClass", "maximumLoadMass")
    else:
        kinds = ("agvKinematic", "agvClass", "maxLoadMass")
    # The schema of 3.0 requires a name that its text does not have.
    extra = {"mobileRobotKinematic": kinematics} if major == 3 else {}  # noqa: PLR2004
    return extra | {
        "seriesName": body.model,
        kinds[0]: kinematics,
        kinds[1]: "CARRIER",
        kinds[2]: 1000.0,
        "localizationTypes": ["NATURAL"],
        "navigationTypes": ["VIRTUAL_LINE_GUIDED"],
    }


def _describe_physics(body: VehicleBody, *, is_3: bool) -> Message:
    limits = body.limits
    values = (0.0, limits.speed, limits.acceleration, limits.deceleration, body.height)
    if is_3:
        names = ("minimumSpeed", "maximumSpeed", "maximumAcceleration", "maximumDeceleration")
        heights: Message = {"minimumHeight": body.height, "maximumHeight": body.height}
        heights["maximumAngularSpeed"] = limits.turn
    else:
        names = ("speedMin", "speedMax", "accelerationMax", "decelerationMax")
        heights = {"heightMin": body.height, "heightMax": body.height}
    size = {"width": body.width, "length": body.length}
    return dict(zip(names, values, strict=False)) | heights | size


def _describe_limits(settings: FleetSettings, *, is_3: bool) -> Message:
    timing = {
        "defaultStateInterval": STATE_PERIOD_S,
        "visualizationInterval": 1.0 / settings.visualization_hz
        if settings.visualization_hz
        else 0.0,
        "minimumOrderInterval" if is_3 else "minOrderInterval": 0.0,
        "minimumStateInterval" if is_3 else "minStateInterval": MIN_STATE_PERIOD_S,
    }
    arrays = dict.fromkeys((*ARRAYS, "trajectory.controlPoints"), MAX_ITEMS)
    if is_3:
        lengths = {"maximumMessageLength": MAX_MESSAGE_BYTES, "maximumIdLength": 256}
        return {"maximumStringLengths": lengths, "maximumArrayLengths": arrays, "timing": timing}
    return {
        "maxStringLens": {"msgLen": MAX_MESSAGE_BYTES, "idLen": 256},
        "maxArrayLens": arrays,
        "timing": timing,
    }


def _describe_features(settings: FleetSettings, *, is_3: bool) -> Message:
    blocking = ["NONE", "SOFT", *(["SINGLE"] if is_3 else []), "HARD"]
    allowed = {"pauseAllowed": "false", "cancelAllowed": "true"} if is_3 else {}
    actions: list[Message] = [
        {
            "actionType": name,
            "actionDescription": one.kind,
            "actionScopes": ["NODE", "EDGE"],
            "blockingTypes": blocking,
        }
        | allowed
        for name, one in settings.all_actions.items()
    ]
    for name in INSTANT_ACTIONS:
        about = {"actionType": name, "actionDescription": name, "actionScopes": ["INSTANT"]}
        actions.append(about | allowed)
    if not is_3:
        # The schema of 2.1 has one blocking type here, and no list.
        actions = [{key: one[key] for key in one if key != "blockingTypes"} for one in actions]
    trajectory = {"parameter": "order.edges.trajectory", "support": "SUPPORTED"}
    return {
        "optionalParameters": [trajectory],
        "mobileRobotActions" if is_3 else "agvActions": actions,
    }
