"""Orders from the network: what is read, and what is refused."""

import json
from typing import Any

import pytest

from tests.zensim.vda5050.orders import action, edge, line, node, order, write
from zensim.vda5050.vda_messages import (
    MAX_MESSAGE_BYTES,
    Major,
    MalformedOrder,
    Order,
    check_order,
    read_message,
)

CURVE = {"degree": 1, "knotVector": [0, 0, 1, 1], "controlPoints": [{"x": 0, "y": 0}] * 2}


def read(part: dict[str, Any]) -> Order:
    return read_message(Order, write(part))


def test_order_of_either_version_is_read() -> None:
    nodes = [
        node(0, (0, 0), allowedDeviationXY=0.2),
        node(2, (1, 0), action("wait", "a", duration=2.5)),
    ]
    ellipse = {"a": 0.3, "b": 0.1, "theta": 0.0}

    old = read(order(nodes, [edge(1, maxSpeed=0.4)]))
    new = read(order([node(0, (0, 0), allowedDeviationXY=ellipse)], [], major=3))

    assert old.nodes[0].node_position is not None
    assert old.nodes[0].node_position.deviation_m == 0.2
    assert old.edges[0].speed_limit == 0.4
    assert old.actions[0].read_number("duration") == 2.5
    assert new.nodes[0].node_position is not None
    assert new.nodes[0].node_position.deviation_m == 0.3


@pytest.mark.parametrize(
    "payload",
    [
        b"",
        b"\xff\xfe",
        b"[]",
        b'{"orderId": "x"}',
        b'{"x":' * 100_000,
        b"[" * 100_000,
        b"{" + b" " * MAX_MESSAGE_BYTES + b"}",
        write(line((0, 0), (1, 0))).replace(b'"x": 1', b'"x": NaN'),
        write(line((0, 0), (1, 0))).replace(b'"x": 1', b'"x": 1e999'),
        write(line((0, 0), (1, 0))).replace(b'"x": 1', b'"x": 1e300'),
        write(line((0, 0), (1, 0), update=-1)),
        write(order([node(2 * at, (at, 0)) for at in range(2000)], [])),
        write(order([], [])),
        write(line((0, 0), (1, 0), name="o" * 300)),
        write(line((0, 0), (1, 0), name="")),
        write(line((0, 0), (1, 0))).replace(b'"nodeId": "n0"', b'"nodeId": ""'),
        write(order([node(0, (0, 0), action("wait", ""))], [])),
    ],
)
def test_hostile_bytes_are_refused_with_one_error(payload: bytes) -> None:
    with pytest.raises(MalformedOrder):
        read_message(Order, payload)


def test_deep_values_of_parameters_are_not_read() -> None:
    deep: list[object] = []
    for _ in range(50):
        deep = [deep]
    given = action("wait", "a", duration=deep, other={"x": 1})

    found = read(order([node(0, (0, 0), given)], [])).actions[0]

    assert found.read("duration") == ""
    assert found.read_number("other") is None


@pytest.mark.parametrize(
    "wrong",
    [
        order([node(0, (0, 0)), node(2, (1, 0))], []),
        order([node(0, (0, 0)), node(4, (1, 0))], [edge(1)]),
        order([node(1, (0, 0))], []),
        order([node(0, (0, 0), released=False)], []),
        line((0, 0), (1, 0), (2, 0), released=0),
        order([node(0, (0, 0)), node(2, (1, 0), released=False)], [edge(1)]),
        order(
            [node(0, (0, 0)), node(2, (1, 0), released=False), node(4, (2, 0))],
            [edge(1, released=False), edge(3)],
        ),
        order([node(0, (0, 0)), node(2, (1, 0))], [edge(1, startNodeId="n9")]),
        order([node(0, (0, 0)), node(2, (1, 0))], [edge(1, startNodeId=None)]),
        order([node(0, (0, 0)), node(2, (1, 0))], [edge(1, maxSpeed=0)]),
        order([node(0, (0, 0)), node(2, (1, 0))], [edge(1, maximumSpeed=0)]),
        order([node(0, (0, 0), action("wait", "a"), action("wait", "a"))], []),
        order([node(0, (0, 0), action("wait", "a", "SINGLE"))], []),
        order([node(0, (0, 0)), node(2, (1, 0))], [edge(1, trajectory=CURVE | {"degree": 2})]),
        order(
            [node(0, (0, 0)), node(2, (1, 0))],
            [edge(1, trajectory=CURVE | {"knotVector": [0, 1, 0, 1]})],
        ),
        line((0, 0), (1, 0), major=3),
    ],
)
def test_contradicting_order_is_found(wrong: dict[str, Any]) -> None:
    assert check_order(read(wrong), 2)


@pytest.mark.parametrize("major", [2, 3])
def test_whole_order_has_no_contradiction(major: Major) -> None:
    given = line((0, 0), (1, 0), (2, 0), released=2, major=major)

    assert check_order(read(given), major) == ""


def test_edges_of_3_need_no_ends() -> None:
    given = json.loads(write(line((0, 0), (1, 0), major=3)))
    for one in given["edges"]:
        del one["startNodeId"], one["endNodeId"]

    assert check_order(read(given), 3) == ""
