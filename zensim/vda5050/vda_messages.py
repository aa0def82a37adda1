"""Messages that vehicles receive, of VDA 5050 2.1 and 3.0 in one form, and what contradicts."""

from collections.abc import Sequence
from itertools import pairwise
from typing import Annotated, Final, Literal, TypeAlias, TypeVar

import msgspec

MAX_MESSAGE_BYTES: Final = 1 << 20
MAX_ITEMS: Final = 1000
"""Nodes of an order, actions of a node, points of a trajectory."""
PI: Final = 3.1415927

Name = Annotated[str, msgspec.Meta(max_length=256)]
Id = Annotated[str, msgspec.Meta(min_length=1, max_length=256)]
Text = Annotated[str, msgspec.Meta(max_length=4096)]
Count = Annotated[int, msgspec.Meta(ge=0, le=(1 << 32) - 1)]
Length = Annotated[float, msgspec.Meta(ge=0.0, le=1e6)]
Place = Annotated[float, msgspec.Meta(ge=-1e9, le=1e9)]
Angle = Annotated[float, msgspec.Meta(ge=-PI, le=PI)]
Weight = Annotated[float, msgspec.Meta(gt=0.0, le=1e6)]
Knot = Annotated[float, msgspec.Meta(ge=0.0, le=1.0)]
Blocking: TypeAlias = Literal["NONE", "SOFT", "SINGLE", "HARD"]
Major: TypeAlias = Literal[2, 3]
Decoded = TypeVar("Decoded", bound=msgspec.Struct)


class MalformedOrder(ValueError):
    """A message is not what its topic has; the text says where and why."""


class ActionParameter(msgspec.Struct, frozen=True):
    """One parameter of an action; its value is JSON of any kind, read when it is used."""

    key: Name
    value: msgspec.Raw = msgspec.Raw(b"null")


class Action(msgspec.Struct, frozen=True, rename="camel"):
    """What a vehicle is to do besides driving."""

    action_type: Name
    action_id: Id
    blocking_type: Blocking = "HARD"
    action_parameters: (
        Annotated[tuple[ActionParameter, ...], msgspec.Meta(max_length=MAX_ITEMS)] | None
    ) = ()

    def has(self, key: str) -> bool:
        """Whether a parameter is given."""
        return any(one.key == key for one in self.action_parameters or ())

    def read(self, key: str) -> str:
        """Read a parameter as a text; empty without it, or if it is no text or number."""
        for one in self.action_parameters or ():
            if one.key == key:
                try:
                    return str(msgspec.json.decode(bytes(one.value), type=str | float))
                except (msgspec.MsgspecError, RecursionError):
                    return ""
        return ""

    def read_number(self, key: str) -> float | None:
        """Read a parameter as a finite number, which may be written as a text."""
        try:
            number = float(self.read(key))
        except ValueError:
            return None
        return number if abs(number) < 1e9 else None  # noqa: PLR2004


class Ellipse(msgspec.Struct, frozen=True):
    """Allowed deviation of 3.0: half axes [m] and the direction of the first [rad]."""

    a: Length
    b: Length
    theta: Angle = 0.0


class NodePosition(msgspec.Struct, frozen=True, rename="camel", omit_defaults=True):
    """Where a node is [m, rad] in the frame of a map."""

    x: Place
    y: Place
    map_id: Name
    theta: Angle | None = None
    deviation: Length | Ellipse | None = msgspec.field(name="allowedDeviationXY", default=None)
    allowed_deviation_theta: Angle | None = None

    @property
    def deviation_m(self) -> float:
        """Radius within which the node counts as reached; 0 = not given."""
        given = self.deviation
        return max(given.a, given.b) if isinstance(given, Ellipse) else (given or 0.0)


class Node(msgspec.Struct, frozen=True, rename="camel", omit_defaults=True):
    """A place of an order."""

    node_id: Id
    sequence_id: Count
    released: bool
    node_position: NodePosition | None = None
    actions: Annotated[tuple[Action, ...], msgspec.Meta(max_length=MAX_ITEMS)] = ()


class ControlPoint(msgspec.Struct, frozen=True):
    """A control point [m] of a NURBS."""

    x: Place
    y: Place
    weight: Weight = 1.0


class CurvedEdge(msgspec.Struct, frozen=True, rename="camel"):
    """A NURBS; without knots it is clamped and uniform."""

    control_points: Annotated[
        tuple[ControlPoint, ...], msgspec.Meta(min_length=2, max_length=MAX_ITEMS)
    ]
    degree: Annotated[int, msgspec.Meta(ge=1, le=9)] = 1
    knot_vector: Annotated[tuple[Knot, ...], msgspec.Meta(max_length=2 * MAX_ITEMS)] = ()


class Edge(msgspec.Struct, frozen=True, rename="camel", omit_defaults=True):
    """The way between two nodes."""

    edge_id: Name
    sequence_id: Count
    released: bool
    start_node_id: Name | None = None
    end_node_id: Name | None = None
    max_speed: Length | None = None
    """Limit of 2.1 [m/s]."""
    maximum_speed: Length | None = None
    """The same of 3.0."""
    orientation: Angle | None = None
    orientation_type: Name | None = None
    trajectory: CurvedEdge | None = None
    actions: Annotated[tuple[Action, ...], msgspec.Meta(max_length=MAX_ITEMS)] = ()

    @property
    def speed_limit(self) -> float | None:
        """Limit [m/s]; None = that of the vehicle."""
        return self.max_speed if self.maximum_speed is None else self.maximum_speed


class Order(msgspec.Struct, frozen=True, rename="camel"):
    """Nodes and edges in the order in which they are traversed."""

    order_id: Id
    order_update_id: Count
    nodes: Annotated[tuple[Node, ...], msgspec.Meta(min_length=1, max_length=MAX_ITEMS)]
    edges: Annotated[tuple[Edge, ...], msgspec.Meta(max_length=MAX_ITEMS)]
    header_id: Count = 0
    version: Name = ""
    manufacturer: Name = ""
    serial_number: Name = ""

    @property
    def actions(self) -> list[Action]:
        """All actions."""
        return [one for part in self.nodes for one in part.actions] + [
            one for part in self.edges for one in part.actions
        ]


class InstantActions(msgspec.Struct, frozen=True, rename="camel"):
    """Actions that begin at once; 2.0 has them under another name."""

    actions: Annotated[tuple[Action, ...], msgspec.Meta(max_length=MAX_ITEMS)] = ()
    instant_actions: Annotated[tuple[Action, ...], msgspec.Meta(max_length=MAX_ITEMS)] = ()
    header_id: Count = 0
    version: Name = ""
    manufacturer: Name = ""
    serial_number: Name = ""


class OrderReference(msgspec.Struct, frozen=True, rename="camel"):
    """What can be read of a malformed order."""

    order_id: Name = ""
    order_update_id: Count = 0


def read_message(kind: type[Decoded], payload: bytes) -> Decoded:
    """Read a message from the network.

    Raises:
        MalformedOrder: It is too large, no JSON, or not of this kind.
    """
    if len(payload) > MAX_MESSAGE_BYTES:
        raise MalformedOrder(f"{len(payload)} bytes are too many; send at most {MAX_MESSAGE_BYTES}")
    try:
        return msgspec.json.decode(payload, type=kind)
    except RecursionError:
        raise MalformedOrder("values are nested too deeply; use at most 100 levels") from None
    except (msgspec.MsgspecError, UnicodeDecodeError) as error:
        raise MalformedOrder(str(error)[:300]) from None


def check_order(order: Order, major: Major) -> str:
    """Say what contradicts itself in an order; empty = nothing."""
    nodes, edges = order.nodes, order.edges
    if order.version and order.version.partition(".")[0] != str(major):
        return f"version {order.version[:20]!r} is not {major}.x"
    if len(edges) != len(nodes) - 1:
        return f"{len(nodes)} nodes need {len(nodes) - 1} edges, and there are {len(edges)}"
    first = nodes[0].sequence_id
    numbers = [one.sequence_id for pair in zip(nodes, edges, strict=False) for one in pair]
    numbers.append(nodes[-1].sequence_id)
    if numbers != list(range(first, first + len(numbers))) or first % 2:
        return "sequenceId of nodes and edges must count on, those of nodes even"
    return _check_release(nodes, edges) or _check_ends(order, major) or _check_details(order, major)


def _check_release(nodes: Sequence[Node], edges: Sequence[Edge]) -> str:
    if not nodes[0].released:
        return f"the first node {nodes[0].node_id!r} is not released"
    parts = [nodes[0], *(one for pair in zip(edges, nodes[1:], strict=True) for one in pair)]
    if any(after.released and not before.released for before, after in pairwise(parts)):
        return "a released node or edge follows one that is not released"
    if any(
        edge.released and not node.released for edge, node in zip(edges, nodes[1:], strict=True)
    ):
        return "an edge is released, and its end node is not"
    return ""


def _check_ends(order: Order, major: Major) -> str:
    for before, edge, after in zip(order.nodes, order.edges, order.nodes[1:], strict=False):
        for what, given, right in (
            ("startNodeId", edge.start_node_id, before.node_id),
            ("endNodeId", edge.end_node_id, after.node_id),
        ):
            if given is None and major == 2:  # noqa: PLR2004
                return f"edge {edge.edge_id!r} has no {what}"
            if given is not None and given != right:
                return f"{what} {given!r} of edge {edge.edge_id!r} is not node {right!r}"
    return ""


def _check_details(order: Order, major: Major) -> str:
    ids = [one.action_id for one in order.actions]
    if len(set(ids)) < len(ids):
        return "two actions have one actionId"
    if major == 2 and any(one.blocking_type == "SINGLE" for one in order.actions):  # noqa: PLR2004
        return "blockingType SINGLE is of 3.0; use NONE, SOFT or HARD"
    for edge in order.edges:
        if edge.speed_limit == 0.0:
            return f"edge {edge.edge_id!r} has a limit of 0 m/s; give more, or none"
        if edge.trajectory is not None and (problem := check_trajectory(edge.trajectory)):
            return f"trajectory of edge {edge.edge_id!r}: {problem}"
    return ""


def check_trajectory(given: CurvedEdge) -> str:
    """Say what is wrong in a NURBS; empty = nothing."""
    count, knots = len(given.control_points), given.knot_vector
    if count <= given.degree:
        return f"degree {given.degree} needs more than {count} control points"
    if knots and len(knots) != count + given.degree + 1:
        return f"{count + given.degree + 1} knots are needed, and there are {len(knots)}"
    if any(after < before for before, after in pairwise(knots)):
        return "knots decrease"
    if knots and knots[given.degree] >= knots[count]:
        return "knots span nothing"
    return ""
