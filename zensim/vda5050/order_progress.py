"""An order and how far a vehicle is with it: acceptance, updates, actions, cancellation; pure."""

from collections.abc import Callable, Iterable, Mapping
from hashlib import sha256
from typing import Final, Literal, TypeAlias

import msgspec

from zensim.vda5050 import order_errors
from zensim.vda5050.order_errors import Rejection
from zensim.vda5050.vda_messages import (
    Action,
    Edge,
    InstantActions,
    Major,
    Node,
    Order,
    check_order,
)

Status: TypeAlias = Literal["WAITING", "RUNNING", "FINISHED", "FAILED"]
STOPPING: Final = frozenset({"SOFT", "HARD"})
"""Blocking types without driving."""
ALONE: Final = frozenset({"SINGLE", "HARD"})
"""Blocking types without other actions."""


class ActionState(msgspec.Struct, frozen=True):
    """An action of an order, and what became of it."""

    action: Action
    sequence_id: int
    """Number of its node or edge."""
    status: Status = "WAITING"
    is_triggered: bool = False
    """Whether its node was passed or its edge was entered."""
    left_s: float = 0.0
    """Simulation time until it is finished, while it is running; infinite = until an event."""
    result: str = ""

    @property
    def is_over(self) -> bool:
        """Whether it is finished or failed."""
        return self.status in ("FINISHED", "FAILED")


class OrderProgress(msgspec.Struct, frozen=True):
    """What a vehicle knows of its order; kept on disk."""

    order_id: str = ""
    update_id: int = 0
    content: str = ""
    """Hash of the nodes and edges of the last message."""
    last_node_id: str = ""
    last_sequence_id: int = 0
    origin: tuple[float, float] = (0.0, 0.0)
    """Where the route to the first node of `nodes` begins [m]."""
    nodes: tuple[Node, ...] = ()
    """Nodes to traverse."""
    edges: tuple[Edge, ...] = ()
    """Edges that lead to them."""
    decision: tuple[str, int] = ("", 0)
    """Last released node: id and sequenceId."""
    has_entered: bool = False
    """Whether the actions of the first edge were triggered."""
    actions: tuple[ActionState, ...] = ()
    is_canceled: bool = False

    @property
    def base(self) -> int:
        """Number of released nodes to traverse."""
        return sum(one.released for one in self.nodes)

    @property
    def is_idle(self) -> bool:
        """Whether there is nothing left to do."""
        return not self.nodes and all(one.is_over for one in self.actions)

    @property
    def is_held(self) -> bool:
        """Whether an action does not let the vehicle drive."""
        return any(
            one.is_triggered and not one.is_over and one.action.blocking_type in STOPPING
            for one in self.actions
        )

    def find_stop(self) -> int:
        """Return the number of nodes up to where the vehicle must stop; 0 = where it is."""
        if self.is_held:
            return 0
        count = self.base
        for at in range(count):
            after = self.edges[at + 1 : at + 2]
            if _stops(self.nodes[at].actions) or (at + 1 < count and _stops(after[0].actions)):
                return at + 1
        return count


class VehicleFacts(msgspec.Struct, frozen=True):
    """What decides whether a vehicle accepts an order.

    Positions are in the map [m].
    """

    major: Major
    position: tuple[float, float]
    map_id: str
    known_actions: Mapping[str, object]
    start_tolerance_m: float = 0.5
    manufacturer: str = ""
    serial: str = ""
    """Serial number of its topics; empty = orders for any vehicle are for this one."""


def _stops(actions: Iterable[Action]) -> bool:
    return any(one.blocking_type in STOPPING for one in actions)


def accept(progress: OrderProgress, order: Order, facts: VehicleFacts) -> OrderProgress:
    """Take over a new order or an update; the same object if it is known already.

    Raises:
        Rejection: The vehicle keeps what it has.
    """
    problem = check_receiver(order, facts.manufacturer, facts.serial)
    if problem := problem or check_order(order, facts.major):
        raise Rejection(order_errors.INVALID, problem)
    content = sha256(msgspec.json.encode((order.nodes, order.edges))).hexdigest()
    is_update = bool(progress.order_id) and order.order_id == progress.order_id
    if is_update and order.order_update_id == progress.update_id:
        if facts.major == 3 and content != progress.content:  # noqa: PLR2004
            text = f"orderUpdateId {order.order_update_id} had other nodes or edges before"
            raise Rejection(order_errors.SAME_ID, text)
        return progress
    _check_actions(order, facts)
    found = _extend(progress, order) if is_update else _begin(progress, order, facts)
    _check_places(order, facts)
    return msgspec.structs.replace(
        found, order_id=order.order_id, update_id=order.order_update_id, content=content
    )


def check_receiver(message: Order | InstantActions, manufacturer: str, serial: str) -> str:
    """Say why a message is for another vehicle; empty if it is for this one, or for any."""
    for key, given, own in (
        ("manufacturer", message.manufacturer, manufacturer),
        ("serialNumber", message.serial_number, serial),
    ):
        if serial and given not in ("", own):
            return f"{key} {given[:80]!r} is not {own!r}, which the topic has"
    return ""


def _check_actions(order: Order, facts: VehicleFacts) -> None:
    for one in order.actions:
        if one.action_type not in facts.known_actions:
            known = ", ".join(sorted(facts.known_actions))
            text = f"actionType {one.action_type!r} is unknown; use one of {known}"
            raise Rejection(order_errors.UNKNOWN_ACTION, text)


def _check_places(order: Order, facts: VehicleFacts) -> None:
    for node, edge in zip(order.nodes[1:], order.edges, strict=True):
        if node.node_position is None and edge.trajectory is None:
            text = f"node {node.node_id!r} has no nodePosition, and no trajectory leads there"
            raise Rejection(order_errors.NO_ROUTE, text)
    for node in order.nodes:
        place = node.node_position
        if place is not None and place.map_id != facts.map_id:
            text = f"mapId {place.map_id!r} of node {node.node_id!r} is not {facts.map_id!r}"
            raise Rejection(order_errors.UNKNOWN_MAP, text)


def _begin(progress: OrderProgress, order: Order, facts: VehicleFacts) -> OrderProgress:
    if not progress.is_idle:
        text = f"order {progress.order_id!r} is not finished; cancel it first"
        raise Rejection(order_errors.BUSY, text)
    if facts.major == 3 and order.order_update_id:  # noqa: PLR2004
        text = f"a new order has orderUpdateId 0, not {order.order_update_id}"
        raise Rejection(order_errors.OUTDATED, text)
    first = order.nodes[0]
    _check_start(progress, first, facts)
    begun = OrderProgress(
        last_node_id=first.node_id,
        last_sequence_id=first.sequence_id,
        origin=facts.position,
        decision=(first.node_id, first.sequence_id),
        actions=tuple(
            ActionState(one, first.sequence_id, is_triggered=True) for one in first.actions
        ),
    )
    return enter_edge(_append(begun, order))


def _check_start(progress: OrderProgress, first: Node, facts: VehicleFacts) -> None:
    place = first.node_position
    if place is None:
        if first.node_id != progress.last_node_id:
            text = f"node {first.node_id!r} has no nodePosition, and the vehicle is not on it"
            raise Rejection(order_errors.START_TOO_FAR, text)
        return
    x, y = facts.position
    distance = ((place.x - x) ** 2 + (place.y - y) ** 2) ** 0.5
    allowed = place.deviation_m or facts.start_tolerance_m
    if distance > allowed:
        text = f"the vehicle is {distance:.2f} m from node {first.node_id!r}, and {allowed:g} m are"
        raise Rejection(order_errors.START_TOO_FAR, f"{text} allowed")


def _extend(progress: OrderProgress, order: Order) -> OrderProgress:
    if order.order_update_id < progress.update_id:
        text = f"orderUpdateId {order.order_update_id} is older than {progress.update_id}"
        raise Rejection(order_errors.OUTDATED, text)
    if progress.is_canceled:
        text = f"order {order.order_id!r} was canceled; send another one"
        raise Rejection(order_errors.AFTER_CANCEL, text)
    first = order.nodes[0]
    if (first.node_id, first.sequence_id) != progress.decision:
        node, sequence = progress.decision
        text = f"the update begins at node {first.node_id!r} ({first.sequence_id}), and the base"
        raise Rejection(order_errors.OUTDATED, f"{text} ends at {node!r} ({sequence})")
    kept = progress.base
    dropped = {one.sequence_id for one in progress.nodes[kept:]}
    dropped |= {one.sequence_id for one in progress.edges[kept:]}
    base = msgspec.structs.replace(
        progress,
        nodes=progress.nodes[:kept],
        edges=progress.edges[:kept],
        actions=tuple(one for one in progress.actions if one.sequence_id not in dropped),
    )
    known = {one.action.action_id for one in base.actions}
    sent = {one.action_id for one in order.actions} - {one.action_id for one in first.actions}
    if known & sent:
        raise Rejection(order_errors.INVALID, "an actionId of the base is used again")
    return enter_edge(_append(base, order))


def _append(progress: OrderProgress, order: Order) -> OrderProgress:
    """Add nodes and edges after the first node, with their actions in order."""
    added = [
        ActionState(action, number)
        for edge, node in zip(order.edges, order.nodes[1:], strict=True)
        for number, actions in ((edge.sequence_id, edge.actions), (node.sequence_id, node.actions))
        for action in actions
    ]
    released = [one for one in order.nodes if one.released][-1]
    return msgspec.structs.replace(
        progress,
        nodes=progress.nodes + order.nodes[1:],
        edges=progress.edges + order.edges,
        decision=(released.node_id, released.sequence_id),
        actions=progress.actions + tuple(added),
    )


def enter_edge(progress: OrderProgress) -> OrderProgress:
    """Enter the first edge, if it is released and no action holds the vehicle."""
    if progress.has_entered or not progress.base or progress.is_held:
        return progress
    number = progress.edges[0].sequence_id
    triggered = _trigger(progress.actions, number)
    return msgspec.structs.replace(progress, has_entered=True, actions=triggered)


def _trigger(actions: tuple[ActionState, ...], number: int) -> tuple[ActionState, ...]:
    return tuple(
        msgspec.structs.replace(one, is_triggered=True) if one.sequence_id == number else one
        for one in actions
    )


def pass_node(progress: OrderProgress, position: tuple[float, float]) -> OrderProgress:
    """Traverse the first node of `nodes`: end the actions of its edge, trigger its own."""
    node, edge = progress.nodes[0], progress.edges[0]
    ended = tuple(
        _end(one) if one.sequence_id == edge.sequence_id and not one.is_over else one
        for one in progress.actions
    )
    place = node.node_position
    passed = msgspec.structs.replace(
        progress,
        last_node_id=node.node_id,
        last_sequence_id=node.sequence_id,
        origin=(place.x, place.y) if place is not None else position,
        nodes=progress.nodes[1:],
        edges=progress.edges[1:],
        has_entered=False,
        actions=_trigger(ended, node.sequence_id),
    )
    return enter_edge(passed)


def _end(one: ActionState) -> ActionState:
    status: Status = "FINISHED" if one.status == "RUNNING" else "FAILED"
    return msgspec.structs.replace(one, status=status, left_s=0.0, result="the edge is left")


def step_actions(
    progress: OrderProgress,
    dt_s: float,
    start: Callable[[Action], float],
    finish: Callable[[Action], str],
) -> OrderProgress:
    """Advance running actions, and start those whose turn it is.

    Args:
        progress: The order.
        dt_s: Simulation time since the last call.
        start: Called before an action runs; returns how long it takes [s].
        finish: Called once when that time is over; returns why it failed, empty = it did not.
    """
    found = [_advance(one, dt_s, finish) for one in progress.actions]
    queue = [at for at, one in enumerate(found) if one.is_triggered and not one.is_over]
    is_running = any(found[at].status == "RUNNING" for at in queue)
    for at in queue:
        is_alone = found[at].action.blocking_type in ALONE
        if found[at].status == "WAITING" and not (is_alone and is_running):
            left_s = start(found[at].action)
            found[at] = msgspec.structs.replace(found[at], status="RUNNING", left_s=left_s)
            is_running = True
        if is_alone:
            break
    if all(new is old for new, old in zip(found, progress.actions, strict=True)):
        return progress
    return enter_edge(msgspec.structs.replace(progress, actions=tuple(found)))


def _advance(one: ActionState, dt_s: float, finish: Callable[[Action], str]) -> ActionState:
    if one.status != "RUNNING":
        return one
    if one.left_s > dt_s:
        return msgspec.structs.replace(one, left_s=one.left_s - dt_s)
    problem = finish(one.action)
    status: Status = "FAILED" if problem else "FINISHED"
    return msgspec.structs.replace(one, status=status, left_s=0.0, result=problem)


def finish_actions(progress: OrderProgress, action_type: str) -> OrderProgress:
    """Let running actions of a type end with the next step."""
    return msgspec.structs.replace(
        progress,
        actions=tuple(
            msgspec.structs.replace(one, left_s=0.0)
            if one.status == "RUNNING" and one.action.action_type == action_type
            else one
            for one in progress.actions
        ),
    )


def cancel(progress: OrderProgress) -> OrderProgress:
    """Drop what is left of an order; its actions fail."""
    return msgspec.structs.replace(
        progress,
        nodes=(),
        edges=(),
        is_canceled=True,
        actions=tuple(
            one
            if one.is_over
            else msgspec.structs.replace(one, status="FAILED", left_s=0.0, result="canceled")
            for one in progress.actions
        ),
    )
