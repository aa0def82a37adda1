"""Limits of COLLADA files."""

import pytest

from zensim.sim_server.description.meshes.collada_check import (
    TooManyInstances,
    check_collada_instances,
)

DRAWN = '<instance_geometry url="#g"/>'


def a_scene(*nodes: str) -> bytes:
    return f'<COLLADA xmlns="urn:c">{"".join(nodes)}</COLLADA>'.encode()


def a_node(name: str, *parts: str) -> str:
    return f'<node id="{name}">{"".join(parts)}</node>'


def make_names(*names: str) -> str:
    return "".join(f'<instance_node url="#{name}"/>' for name in names)


def doubled(times: int) -> bytes:
    above = (a_node(f"n{i}", make_names(f"n{i - 1}", f"n{i - 1}")) for i in range(1, times))
    return a_scene(a_node("n0", DRAWN), *above)


@pytest.mark.parametrize(
    "data",
    [
        a_scene(a_node("a", DRAWN * 20_000)),
        a_scene(a_node("a", DRAWN, make_names("ghost"))),
        a_scene(
            a_node("a", DRAWN), a_node("b", make_names("a", "a"), a_node("c", make_names("a")))
        ),
        doubled(10),
    ],
)
def test_nodes_are_accepted_with_few_instances(data: bytes) -> None:
    check_collada_instances(data)


@pytest.mark.parametrize(
    "data",
    [
        a_scene(a_node("a", make_names("a"))),
        a_scene(
            a_node("a", make_names("b")), a_node("b", make_names("c")), a_node("c", make_names("a"))
        ),
        doubled(30),
        doubled(3000),
    ],
)
def test_nodes_are_refused_when_instances_multiply(data: bytes) -> None:
    with pytest.raises(TooManyInstances):
        check_collada_instances(data)
