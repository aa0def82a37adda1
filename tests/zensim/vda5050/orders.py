"""Orders as fleet managers write them."""

import json
from collections.abc import Sequence
from typing import Any

Part = dict[str, Any]


def action(name: str, number: str, blocking: str = "HARD", **parameters: object) -> Part:
    """Write an action."""
    pairs = [{"key": key, "value": value} for key, value in parameters.items()]
    return {
        "actionType": name,
        "actionId": number,
        "blockingType": blocking,
        "actionParameters": pairs,
    }


def node(
    number: int,
    place: tuple[float, float] | None,
    *actions: Part,
    released: bool = True,
    **position: object,
) -> Part:
    """Write a node; its id is `n` and its sequenceId."""
    found: Part = {
        "nodeId": f"n{number}",
        "sequenceId": number,
        "released": released,
        "actions": list(actions),
    }
    if place is not None:
        where = {"x": place[0], "y": place[1], "mapId": "default"}
        found["nodePosition"] = where | position
    return found


def edge(number: int, *actions: Part, released: bool = True, **fields: object) -> Part:
    """Write the edge between two nodes."""
    ends = {"startNodeId": f"n{number - 1}", "endNodeId": f"n{number + 1}"}
    head = {"edgeId": f"e{number}", "sequenceId": number, "released": released}
    return head | ends | {"actions": list(actions)} | fields


def order(
    nodes: Sequence[Part], edges: Sequence[Part], name: str = "o1", update: int = 0, major: int = 2
) -> Part:
    """Write an order with its header."""
    return header(major) | {
        "orderId": name,
        "orderUpdateId": update,
        "nodes": list(nodes),
        "edges": list(edges),
    }


def header(major: int = 2) -> Part:
    """Write a header."""
    return {
        "headerId": 7,
        "timestamp": "2026-01-01T00:00:00.000Z",
        "version": "2.1.0" if major == 2 else "3.0.0",
        "manufacturer": "zensim",
        "serialNumber": "r1",
    }


def line(
    *places: tuple[float, float],
    released: int | None = None,
    name: str = "o1",
    update: int = 0,
    major: int = 2,
) -> Part:
    """Write an order along places; the first `released` of them are its base."""
    count = len(places) if released is None else released
    nodes = [node(2 * at, place, released=at < count) for at, place in enumerate(places)]
    edges = [edge(2 * at + 1, released=at + 1 < count) for at in range(len(places) - 1)]
    return order(nodes, edges, name, update, major)


def write(part: Part) -> bytes:
    """Write JSON."""
    return json.dumps(part).encode()
