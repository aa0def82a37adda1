"""The action SimulateSteps against an independent implementation of types, hashes and bytes."""

from typing import Any, cast

import msgspec
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import get_types_from_msg
from rosbags.typesys.store import Typestore

from proto import ros_actions as action
from proto.codec import Format, decode, encode
from proto.example import example_of
from proto.ros2.type_hash import service_hash, service_type, type_hash
from tests.proto.ros2.test_type_hash import oracle_store
from tests.proto.ros_oracle import as_ros

STEPS = "simulation_interfaces/action/SimulateSteps"
UUID = "unique_identifier_msgs/UUID"
DEFINITIONS = {
    f"{STEPS}_Goal": "uint64 steps",
    f"{STEPS}_Result": "simulation_interfaces/Result result",
    f"{STEPS}_Feedback": "uint64 completed_steps\nuint64 remaining_steps",
    f"{STEPS}_SendGoal_Response": "bool accepted\nbuiltin_interfaces/Time stamp",
    f"{STEPS}_GetResult_Request": f"{UUID} goal_id",
    "action_msgs/srv/CancelGoal_Request": "action_msgs/GoalInfo goal_info",
    "action_msgs/srv/CancelGoal_Response": "int8 return_code\n"
    "action_msgs/GoalInfo[] goals_canceling",
}
"""As rosidl makes them; of those that hold another, that is put in by hand."""
NESTED = {
    f"{STEPS}_SendGoal_Request": (f"{UUID} goal_id", "goal", f"{STEPS}_Goal"),
    f"{STEPS}_GetResult_Response": ("int8 status", "result", f"{STEPS}_Result"),
    f"{STEPS}_FeedbackMessage": (f"{UUID} goal_id", "feedback", f"{STEPS}_Feedback"),
}
KINDS = [
    *action.TOPICS.values(),
    *(kind for halves in action.SERVICES.values() for kind in halves),
]


def store_of_action() -> Typestore:
    store = oracle_store()
    known = cast("dict[str, Any]", store.fielddefs)
    for name, text in DEFINITIONS.items():
        known[name] = fields_of(text)
    for name, (text, field, kind) in NESTED.items():
        constants, fields = fields_of(text)
        known[name] = (constants, [*fields, (field, (Nodetype.NAME, kind))])
    return store


def fields_of(text: str) -> Any:  # noqa: ANN401  rosbags' own form
    (found,) = get_types_from_msg(text, "any/msg/Any").values()
    return found


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_type_of_the_action_has_the_hash_that_another_implementation_finds(
    kind: type[msgspec.Struct],
) -> None:
    assert type_hash(kind) == store_of_action().hash_rihs01(str(vars(kind)["ros_type"]))


@pytest.mark.parametrize("name", action.SERVICES)
def test_service_of_the_action_has_the_hash_that_another_implementation_finds(name: str) -> None:
    request, response = action.SERVICES[name]
    store, kind = store_of_action(), service_type(request)
    known = cast("dict[str, Any]", store.fielddefs)
    halves = [(Nodetype.NAME, f"{kind}_{half}") for half in ("Request", "Response")]
    info = (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo")
    listed = [(Nodetype.SEQUENCE, (half, 1)) for half in halves]
    event = [("info", info), ("request", listed[0]), ("response", listed[1])]
    known[f"{kind}_Event"] = ([], event)
    parts = [*halves, (Nodetype.NAME, f"{kind}_Event")]
    names = ("request_message", "response_message", "event_message")
    known[kind] = ([], list(zip(names, parts, strict=True)))

    assert service_hash(request, response) == store.hash_rihs01(kind)


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.__name__)
def test_message_of_the_action_is_written_and_read(kind: type[msgspec.Struct]) -> None:
    message = example_of(kind)

    assert decode(kind, encode(message, Format.CDR)) == message


def test_status_of_goals_has_the_bytes_that_ros_writes() -> None:
    store = store_of_action()
    info = action.GoalInfo(action.GoalId(tuple(range(16))))
    message = action.GoalStatusArray((action.StatusOfGoal(info, 2),))

    name = "action_msgs/msg/GoalStatusArray"
    written = bytes(store.serialize_cdr(as_ros(message, name), name))

    assert encode(message, Format.CDR) == written
