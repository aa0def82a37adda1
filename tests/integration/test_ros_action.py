"""The action /simulate_steps, called by an independent client by the rules of rcl_action.

The rules: the client chooses the goal id; three services and two topics are under `_action/`; the
status topic is latched and published at each change; a cancel reply lists canceled goals.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
import zenoh

from tests.integration.processes import Server, eventually, serving
from tests.integration.ros_client_process import (
    CallObserver,
    CallService,
    make_service_call,
    replies,
    run_observer,
    session_of,
)
from tests.integration.ros_rules import check_bytes, check_topic, to_received_sample
from tests.integration.ros_subscriptions import (
    DISCOVERY_S,
    TRANSIENT_LOCAL,
    publishers_of,
    subscribe_transient_local,
)
from tests.proto.ros_hashes import hash_of_message, hash_of_service
from tests.proto.ros_oracle import HUMBLE
from zensim.proto.messages.simulation_messages import State

STEPS = "simulation_interfaces/action/SimulateSteps"
UNDER = "/simulate_steps/_action"
FEEDBACK, STATUS = f"{UNDER}/feedback", f"{UNDER}/status"
STATUSES = "action_msgs/msg/GoalStatusArray"
EXECUTING, SUCCEEDED, CANCELED = 2, 4, 5
ENDLESS = 5_000_000
OK, REJECTED_AS_UNKNOWN = 1, 2


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving("--ros-domain", "0", "--ros-bridge") as found:
        found.client.set_simulation_state(State.PAUSED)
        yield found


@pytest.fixture(scope="module")
def observe(server: Server) -> Iterator[CallObserver]:
    with run_observer(server, 0) as found:
        yield found


def goal_of(number: int) -> dict[str, object]:
    return {"uuid": [number, *range(15)]}


def send(call_service: CallService, number: int, steps: int) -> dict[str, object]:
    kind = f"{STEPS}_SendGoal"
    response = call_service(
        f"{UNDER}/send_goal", kind, hash_of_service(kind), goal_id=goal_of(number), steps=steps
    )
    assert response is not None
    return response


def result(call_service: CallService, number: int) -> dict[str, object]:
    kind = f"{STEPS}_GetResult"
    response = call_service(
        f"{UNDER}/get_result", kind, hash_of_service(kind), goal_id=goal_of(number)
    )
    assert response is not None
    return response


def cancel(call_service: CallService, number: int) -> dict[str, object]:
    kind = "action_msgs/srv/CancelGoal"
    info = {"goal_id": goal_of(number)}
    response = call_service(f"{UNDER}/cancel_goal", kind, hash_of_service(kind), goal_info=info)
    assert response is not None
    return response


def told_of(received: list[dict[str, list[dict[str, object]]]], number: int) -> list[object]:
    """List the statuses of one goal, without repetitions."""
    all_told = [
        one["status"]
        for message in received
        for one in message["status_list"]
        if one["goal_info"]["goal_id"] == goal_of(number)  # type: ignore[index]
    ]
    return [one for at, one in enumerate(all_told) if at == 0 or one != all_told[at - 1]]


def test_goal_is_accepted_reports_progress_and_succeeds(
    server: Server, observe: CallObserver
) -> None:
    call_service = make_service_call(observe)
    observe("subscribe", topic=FEEDBACK, kind=f"{STEPS}_FeedbackMessage", qos="")
    observe("subscribe", topic=STATUS, kind=STATUSES, qos=TRANSIENT_LOCAL)
    before = server.steps()

    sent = send(call_service, 1, 30)
    ended = result(call_service, 1)

    assert sent["accepted"]
    assert sent["stamp"] != {"sec": 0, "nanosec": 0}
    assert ended == {"status": SUCCEEDED, "result": {"result": OK, "error_message": ""}}
    assert server.steps() == before + 30
    eventually(
        lambda: told_of(observe("received", topic=STATUS), 1)[-1:] == [SUCCEEDED],
        DISCOVERY_S,
        "status",
    )
    assert told_of(observe("received", topic=STATUS), 1) == [EXECUTING, SUCCEEDED]
    eventually(lambda: is_complete(observe("received", topic=FEEDBACK)), DISCOVERY_S, "feedback")
    assert observe("received", topic=FEEDBACK)[-1]["goal_id"] == goal_of(1)


def is_complete(feedback: list[dict[str, object]]) -> bool:
    """Whether the newest feedback is that of the last of 30 steps."""
    return bool(feedback) and [
        feedback[-1][one] for one in ("completed_steps", "remaining_steps")
    ] == [30, 0]


def test_feedback_follows_rmw_rules_and_matches_rosbags_bytes(
    server: Server, observe: CallObserver
) -> None:
    with session_of(server) as session:
        channel = session.declare_subscriber(f"0{FEEDBACK}/*/*", zenoh.handlers.FifoChannel(64))
        publishers_of(session, FEEDBACK)  # the router replies after it took the subscription
        send(make_service_call(observe), 5, 20)
        samples = [to_received_sample(channel.recv())]
        channel.undeclare()
        received = publishers_of(session, FEEDBACK)

    (publisher,) = check_topic(received, samples)
    assert (publisher.name, publisher.ros_type) == (FEEDBACK, f"{STEPS}_FeedbackMessage")
    check_bytes(publisher.ros_type, samples[0].payload)


def test_canceled_goal_is_listed_and_ends_canceled(observe: CallObserver) -> None:
    call_service = make_service_call(observe)
    send(call_service, 2, ENDLESS)

    canceled = cancel(call_service, 2)
    ended = result(call_service, 2)

    assert canceled["return_code"] == 0
    named = canceled["goals_canceling"]
    assert isinstance(named, list)
    assert [one["goal_id"] for one in named] == [goal_of(2)]
    assert ended["status"] == CANCELED


def test_unsent_goal_is_unknown(observe: CallObserver) -> None:
    call_service = make_service_call(observe)

    assert cancel(call_service, 99)["return_code"] == REJECTED_AS_UNKNOWN
    assert result(call_service, 99)["status"] == 0


def test_goal_is_refused_while_time_runs(server: Server, observe: CallObserver) -> None:
    server.client.set_simulation_state(State.PLAYING)
    try:
        assert not send(make_service_call(observe), 3, 10)["accepted"]
    finally:
        server.client.set_simulation_state(State.PAUSED)


def statuses_of(sample: zenoh.Sample, number: int) -> list[int]:
    message: Any = HUMBLE.deserialize_cdr(sample.payload.to_bytes(), STATUSES)
    listed = message.status_list
    return [one.status for one in listed if one.goal_info.goal_id.uuid[0] == number]


def test_rmw_subscriber_receives_each_status_change(server: Server, observe: CallObserver) -> None:
    key = f"0{STATUS}/action_msgs::msg::dds_::GoalStatusArray_/{hash_of_message(STATUSES)}"
    samples: list[list[int]] = []

    with session_of(server) as session:
        joiner = subscribe_transient_local(
            session, key, lambda sample: samples.append(statuses_of(sample, 4))
        )
        eventually(lambda: bool(samples), DISCOVERY_S, "what was before")
        send(make_service_call(observe), 4, ENDLESS)
        eventually(lambda: samples[-1] == [EXECUTING], DISCOVERY_S, "the beginning")
        cancel(make_service_call(observe), 4)
        eventually(lambda: samples[-1] == [CANCELED], DISCOVERY_S, "the end")
        joiner.undeclare()


def test_bridge_sends_a_goal_on_plain_keys_and_discovers_the_action(server: Server) -> None:
    name = f"{STEPS}_SendGoal"
    uuid = HUMBLE.types["unique_identifier_msgs/msg/UUID"](np.arange(60, 76, dtype=np.uint8))
    goal = HUMBLE.types[f"{STEPS}_Goal"](5)
    request = HUMBLE.types[f"{name}_Request"](uuid, goal)
    payload = bytes(HUMBLE.serialize_cdr(request, f"{name}_Request"))

    (sent,) = replies(server, f"{UNDER}/send_goal".strip("/"), payload, None)

    response: Any = HUMBLE.deserialize_cdr(sent.payload.to_bytes(), f"{name}_Response")
    assert response.accepted
    received = {
        "/".join(route.split("/")[3:]) for route in server.bus.list_tokens("@/*/@ros2_lv/**")
    }
    assert "AS/simulate_steps/simulation_interfaces§action§SimulateSteps" in received
    assert not [route for route in received if "_action" in route]
