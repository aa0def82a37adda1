"""COLLADA nodes that name nodes are counted before they are drawn."""

import pytest

from zensim.sim_server.description.collada import DrawnTooOften, check_drawn

DRAWN = '<instance_geometry url="#g"/>'


def a_scene(*nodes: str) -> bytes:
    return f'<COLLADA xmlns="urn:c">{"".join(nodes)}</COLLADA>'.encode()


def a_node(name: str, *parts: str) -> str:
    return f'<node id="{name}">{"".join(parts)}</node>'


def naming(*names: str) -> str:
    return "".join(f'<instance_node url="#{name}"/>' for name in names)


def doubled(times: int) -> bytes:
    above = (a_node(f"n{i}", naming(f"n{i - 1}", f"n{i - 1}")) for i in range(1, times))
    return a_scene(a_node("n0", DRAWN), *above)


@pytest.mark.parametrize(
    "data",
    [
        a_scene(a_node("a", DRAWN * 20_000)),
        a_scene(a_node("a", DRAWN, naming("ghost"))),
        a_scene(a_node("a", DRAWN), a_node("b", naming("a", "a"), a_node("c", naming("a")))),
        doubled(10),
    ],
)
def test_nodes_are_taken_when_they_draw_little(data: bytes) -> None:
    check_drawn(data)


@pytest.mark.parametrize(
    "data",
    [
        a_scene(a_node("a", naming("a"))),
        a_scene(a_node("a", naming("b")), a_node("b", naming("c")), a_node("c", naming("a"))),
        doubled(30),
        doubled(3000),
    ],
)
def test_nodes_are_refused_when_they_draw_without_end(data: bytes) -> None:
    with pytest.raises(DrawnTooOften):
        check_drawn(data)
