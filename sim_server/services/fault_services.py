"""The service that lets parts of bodies and topics of sensors fail for a time."""

import math
from typing import cast, get_args

from zensim.proto import keys
from zensim.proto import topic_catalog as topics
from zensim.proto.messages.fault_messages import (
    BodyFaultKind,
    InjectFaultRequest,
    InjectFaultResponse,
    TopicFault,
    TopicFaultKind,
)
from zensim.proto.messages.result_messages import ResultCode
from zensim.proto.messages.standard_messages import NANOSECONDS, Duration
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.queries.frame_queries import SCOPE_SEPARATOR, find_joint, find_link
from zensim.sim_server.world.applied_forces import TimeSpan
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.injected_faults import BodyFault, TimedTopicFault
from zensim.sim_server.world.simulated_world import SimulatedWorld

BODY_KINDS: tuple[BodyFaultKind, ...] = get_args(BodyFaultKind)
TOPIC_KINDS: tuple[TopicFaultKind, ...] = get_args(TopicFaultKind)
MAX_FAULT_NUMBER = 1e6
RAY_TOPICS = (topics.SCAN, topics.POINTS, topics.POINT_CLOUD)
NUMBER_TOPICS = (*RAY_TOPICS, topics.RANGE, topics.IMU)
OF_NUMBERS = "a lidar, a range finder or an imu", NUMBER_TOPICS
CHANGED_TOPICS = {
    **dict.fromkeys(("sensor_noise", "sensor_bias"), OF_NUMBERS),
    "sensor_sector": ("a lidar", RAY_TOPICS),
}
"""Sensors whose numbers a kind of fault changes, and their topics; the other kinds act on all."""


def inject_fault(world: SimulatedWorld, request: InjectFaultRequest) -> InjectFaultResponse:
    """Let a part of an entity fail from the present step on.

    Raises:
        EntityNotFound: There is no such entity.
        RequestRefused: There is no such kind or part, or a number is out of range.
        EngineRefused: The engine cannot simulate it.
    """
    entity = world.entities.find(request.entity)
    _check_numbers(request)
    span = _make_span(world, request.duration)
    if request.kind in BODY_KINDS:
        world.add_body_fault(_make_body_fault(world, request, span))
    elif request.kind in TOPIC_KINDS:
        world.injected_faults.add_topic_fault(_make_topic_fault(entity, request, span))
    else:
        known = ", ".join((*BODY_KINDS, *TOPIC_KINDS))
        raise RequestRefused(
            ResultCode.OPERATION_FAILED, f"fault {request.kind[:40]!r} is not known; use {known}"
        )
    return InjectFaultResponse()


def _check_numbers(request: InjectFaultRequest) -> None:
    numbers = {"value": request.value, "low": request.low, "high": request.high}
    for what, number in numbers.items():
        if not (math.isfinite(number) and abs(number) <= MAX_FAULT_NUMBER):
            raise RequestRefused(
                ResultCode.OPERATION_FAILED,
                f"{what} {number:g} is out of range; use a finite number, {MAX_FAULT_NUMBER:g} "
                "at most",
            )
    if request.value < 0.0 and request.kind != "sensor_bias":
        raise RequestRefused(
            ResultCode.OPERATION_FAILED, f"value {request.value:g} is negative; use 0 or more"
        )


def _make_span(world: SimulatedWorld, duration: Duration) -> TimeSpan:
    now_ns = world.clock.time_ns
    if duration.sec < 0:
        return TimeSpan(now_ns, None)
    return TimeSpan(now_ns, now_ns + duration.sec * NANOSECONDS + duration.nanosec)


def _make_body_fault(
    world: SimulatedWorld, request: InjectFaultRequest, span: TimeSpan
) -> BodyFault:
    scoped = f"{request.entity}{SCOPE_SEPARATOR}{request.part}"
    kind = cast("BodyFaultKind", request.kind)
    if kind == "link_broken":
        return BodyFault(request.entity, kind, find_link(world, scoped).number, 0.0, 0.0, span)
    joint = find_joint(world, scoped)
    if joint.joint.kind == "fixed":
        raise RequestRefused(
            ResultCode.OPERATION_FAILED, f"joint {scoped[:80]!r} is fixed; name one that moves"
        )
    if kind == "wheel_slip":
        # Link i + 1 is the child of joint i.
        return BodyFault(request.entity, kind, joint.number + 1, request.value, 0.0, span)
    row = world.entities.index.joints_of(request.entity).start + joint.number
    position = float(world.states().joint_positions[row])
    return BodyFault(request.entity, kind, joint.number, request.value, position, span)


def _make_topic_fault(
    entity: Entity, request: InjectFaultRequest, span: TimeSpan
) -> TimedTopicFault:
    sensors = [one for one in entity.model.sensors if one.settings is not None]
    found = next((one for one in sensors if one.name == request.part), None)
    if found is None:
        known = ", ".join(one.name for one in sensors) or "it has none"
        raise RequestRefused(
            ResultCode.NOT_FOUND,
            f"'{entity.name}' has no sensor {request.part[:80]!r}; sensors: {known}",
        )
    of_what, changed = CHANGED_TOPICS.get(request.kind, ("", ()))
    if changed and not {one.topic for one in found.topics} & {one.name for one in changed}:
        raise RequestRefused(
            ResultCode.OPERATION_FAILED,
            f"{request.kind} has no effect on sensor {found.name!r} of '{entity.name}'; it is for "
            f"{of_what}",
        )
    fault = TopicFault(
        tuple(keys.robot(entity.namespace or entity.name, one.name) for one in found.topics),
        cast("TopicFaultKind", request.kind),
        request.value,
        request.low,
        request.high,
        span.start_ns,
        request.seed,
    )
    return TimedTopicFault(entity.name, fault, span)
