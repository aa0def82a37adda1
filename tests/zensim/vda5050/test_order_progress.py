"""Acceptance of orders and updates, and their actions, as the standard says."""

from collections.abc import Callable
from typing import Any

import pytest

from tests.zensim.vda5050.orders import action, edge, line, node, order, write
from zensim.vda5050 import order_errors
from zensim.vda5050.order_errors import ErrorKind, Rejection
from zensim.vda5050.order_progress import (
    OrderProgress,
    VehicleFacts,
    accept,
    cancel,
    pass_node,
    step_actions,
)
from zensim.vda5050.vda_messages import Action, Major, Order, read_message

KNOWN = dict.fromkeys(("wait", "pick"))


def take(
    progress: OrderProgress,
    given: dict[str, Any],
    major: Major = 2,
    position: tuple[float, float] = (0.0, 0.0),
) -> OrderProgress:
    facts = VehicleFacts(major, position, "default", KNOWN)
    return accept(progress, read_message(Order, write(given)), facts)


def run(
    progress: OrderProgress, dt_s: float = 0.1, finish: Callable[[Action], str] = lambda _: ""
) -> OrderProgress:
    return step_actions(progress, dt_s, lambda _: 1.0, finish)


def statuses(progress: OrderProgress) -> list[str]:
    return [one.status for one in progress.actions]


def arrive(progress: OrderProgress) -> OrderProgress:
    while progress.base:
        progress = pass_node(progress, (0.0, 0.0))
    return progress


def test_order_begins_on_its_first_node_with_base_and_horizon() -> None:
    found = take(OrderProgress(), line((0, 0), (1, 0), (2, 0), released=2))

    assert found.last_node_id == "n0"
    assert [one.node_id for one in found.nodes] == ["n2", "n4"]
    assert found.base == found.find_stop() == 1
    assert found.decision == ("n2", 2)
    assert not found.is_idle


def test_update_extends_the_base_and_replaces_the_horizon() -> None:
    begun = take(OrderProgress(), line((0, 0), (1, 0), (2, 0), released=2))
    nodes = [node(2, (1, 0)), node(4, (1, 1)), node(6, (1, 2), released=False)]

    found = take(begun, order(nodes, [edge(3), edge(5, released=False)], update=1))

    places = [one.node_position for one in found.nodes]
    assert [(one.x, one.y) for one in places if one is not None] == [(1, 0), (1, 1), (1, 2)]
    assert (found.base, found.update_id, found.decision) == (2, 1, ("n4", 4))


def test_update_continues_a_finished_order() -> None:
    done = arrive(take(OrderProgress(), line((0, 0), (1, 0))))
    nodes = [node(2, (1, 0)), node(4, (1, 1))]

    found = take(done, order(nodes, [edge(3)], update=1))

    assert done.is_idle
    assert [one.node_id for one in found.nodes] == ["n4"]


def test_same_order_again_changes_nothing() -> None:
    begun = take(OrderProgress(), line((0, 0), (1, 0)))

    assert take(begun, line((0, 0), (1, 0))) is begun
    assert take(arrived := arrive(begun), line((0, 0), (1, 0))) is arrived


@pytest.mark.parametrize(
    ("given", "kind", "major"),
    [
        (line((0, 0), (1, 0), name="o2"), order_errors.BUSY, 2),
        (line((0, 0), (1, 0), update=1), order_errors.OUTDATED, 2),
        (order([node(4, (2, 0))], [], update=3), order_errors.OUTDATED, 2),
        (order([node(2, (1, 0))], [], update=1), order_errors.OUTDATED, 2),
        (line((0, 0), (1, 5), update=2, major=3), order_errors.SAME_ID, 3),
        (order([node(2, (1, 0)), node(4, None)], [edge(3)], update=3), order_errors.NO_ROUTE, 2),
        (order([node(0, (0, 0))], [edge(1)], update=3), order_errors.INVALID, 2),
        (
            order([node(2, (1, 0)), node(4, (2, 0), mapId="other")], [edge(3)], update=3),
            order_errors.UNKNOWN_MAP,
            2,
        ),
        (
            order([node(2, (1, 0)), node(4, (2, 0), action("fly", "f"))], [edge(3)], update=3),
            order_errors.UNKNOWN_ACTION,
            2,
        ),
    ],
)
def test_rejected_order_leaves_the_vehicle_as_it_is(
    given: dict[str, Any], kind: ErrorKind, major: Major
) -> None:
    begun = take(OrderProgress(), line((0, 0), (1, 0), update=0, major=major), major)
    extended = take(begun, order([node(2, (1, 0))], [], update=2, major=major), major)

    with pytest.raises(Rejection) as caught:
        take(extended, given, major)

    assert caught.value.kind is kind


@pytest.mark.parametrize(
    ("position", "fields"), [((0.4, 0), {}), ((3, 0), {"allowedDeviationXY": 4})]
)
def test_first_node_may_be_within_its_deviation(
    position: tuple[float, float], fields: dict[str, Any]
) -> None:
    given = order([node(0, (0, 0), **fields), node(2, (1, 0))], [edge(1)])

    assert take(OrderProgress(), given, position=position).origin == position


def test_first_node_must_be_near() -> None:
    with pytest.raises(Rejection) as caught:
        take(OrderProgress(), line((0, 0), (1, 0)), position=(0.6, 0))

    assert caught.value.kind is order_errors.START_TOO_FAR


def test_node_without_a_position_begins_an_order_where_the_vehicle_stands() -> None:
    done = arrive(take(OrderProgress(), line((0, 0), (1, 0))))
    given = order([node(2, None), node(4, (2, 0))], [edge(3)], name="o2")

    assert take(done, given).last_node_id == "n2"


def test_errors_have_the_names_and_levels_of_each_version() -> None:
    assert order_errors.OUTDATED.name(2) == "orderUpdateError"
    assert order_errors.OUTDATED.name(3) == "OUTDATED_ORDER_UPDATE"
    assert order_errors.OFF_ROUTE.level(2) == "FATAL"
    assert order_errors.OFF_ROUTE.level(3) == "CRITICAL"


def test_hard_action_holds_the_vehicle_until_it_is_finished() -> None:
    nodes = [node(0, (0, 0)), node(2, (1, 0), action("wait", "a")), node(4, (2, 0))]
    begun = take(OrderProgress(), order(nodes, [edge(1), edge(3)]))

    on_node = run(pass_node(begun, (1.0, 0.0)))
    running = run(on_node, 0.5)
    finished = run(running, 0.6)

    assert begun.find_stop() == 1
    assert (statuses(on_node), on_node.find_stop(), on_node.has_entered) == (["RUNNING"], 0, False)
    assert statuses(running) == ["RUNNING"]
    assert (statuses(finished), finished.find_stop(), finished.has_entered) == (
        ["FINISHED"],
        1,
        True,
    )


@pytest.mark.parametrize(
    ("blocking", "expected"),
    [
        (("NONE", "NONE"), ["RUNNING", "RUNNING"]),
        (("SOFT", "NONE"), ["RUNNING", "RUNNING"]),
        (("NONE", "HARD"), ["RUNNING", "WAITING"]),
        (("HARD", "NONE"), ["RUNNING", "WAITING"]),
        (("SINGLE", "NONE"), ["RUNNING", "WAITING"]),
        (("NONE", "SINGLE"), ["RUNNING", "WAITING"]),
        (("SOFT", "SOFT"), ["RUNNING", "RUNNING"]),
    ],
)
def test_blocking_types_say_what_runs_together(
    blocking: tuple[str, str], expected: list[str]
) -> None:
    actions = [action("wait", str(at), one) for at, one in enumerate(blocking)]
    begun = take(OrderProgress(), order([node(0, (0, 0), *actions)], [], major=3), 3)

    assert statuses(run(begun)) == expected
    assert begun.is_held is bool({"SOFT", "HARD"} & set(blocking))
    assert statuses(run(run(run(run(begun), 2.0), 2.0), 2.0)) == ["FINISHED", "FINISHED"]


def test_actions_of_an_edge_end_with_it() -> None:
    nodes = [node(0, (0, 0)), node(2, (1, 0))]
    begun = run(take(OrderProgress(), order(nodes, [edge(1, action("wait", "a", "NONE"))])))

    assert statuses(begun) == ["RUNNING"]
    assert statuses(pass_node(begun, (1.0, 0.0))) == ["FINISHED"]


def test_vehicle_stops_before_an_edge_whose_action_does_not_let_it_drive() -> None:
    nodes = [node(0, (0, 0)), node(2, (1, 0)), node(4, (2, 0))]
    begun = take(OrderProgress(), order(nodes, [edge(1), edge(3, action("wait", "a", "HARD"))]))

    on_node = run(pass_node(begun, (1.0, 0.0)))

    assert begun.find_stop() == 1
    assert (statuses(on_node), on_node.find_stop()) == (["RUNNING"], 0)


def test_canceled_order_is_idle_and_takes_no_update() -> None:
    nodes = [node(0, (0, 0), action("wait", "a")), node(2, (1, 0))]
    begun = run(take(OrderProgress(), order(nodes, [edge(1)], major=3), 3))

    gone = cancel(begun)

    assert gone.is_idle
    assert (gone.order_id, statuses(gone)) == ("o1", ["FAILED"])
    with pytest.raises(Rejection) as caught:
        take(gone, order([node(2, (1, 0))], [], update=1, major=3), 3)
    assert caught.value.kind is order_errors.AFTER_CANCEL
    assert not take(gone, line((0, 0), (1, 0), name="o2", major=3), 3).is_idle


def test_failed_action_has_its_reason() -> None:
    begun = run(take(OrderProgress(), order([node(0, (0, 0), action("pick", "a"))], [])))

    found = run(begun, 2.0, lambda _: "there is nothing")

    assert [(one.status, one.result) for one in found.actions] == [("FAILED", "there is nothing")]
