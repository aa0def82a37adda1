"""How often a COLLADA file draws a geometry: nodes name nodes, each of which may name more."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lxml import etree

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lxml.etree import _Element as Element

MAX_DRAWN = 10_000
NESTED = b"instance_node"


class DrawnTooOften(ValueError):
    """Nodes name one another in a circle, or come to more geometries than are read."""


def check_drawn(data: bytes) -> None:
    """Count geometries before anything follows the names.

    Raises:
        DrawnTooOften: There are more than 10,000, or no end of them.
        XMLSyntaxError: The bytes are no XML.
    """
    if NESTED not in data:
        return
    parser = etree.XMLParser(load_dtd=False, no_network=True, resolve_entities=False)
    nodes = {
        f"#{node.get('id')}": node
        for node in etree.fromstring(data, parser).iter("{*}node")
        if node.get("id")
    }
    _count(nodes)


def _count(nodes: Mapping[str, Element]) -> None:
    drawn: dict[str, int] = {}
    for name in nodes:
        path = [(name, iter(_named(nodes[name], nodes)))] if name not in drawn else []
        open_names = {name}
        while path:
            at, below = path[-1]
            inner = next((one for one in below if one not in drawn), "")
            if inner in open_names:
                raise DrawnTooOften
            if inner:
                open_names.add(inner)
                path.append((inner, iter(_named(nodes[inner], nodes))))
                continue
            path.pop()
            open_names.discard(at)
            own = sum(1 for _ in nodes[at].iter("{*}instance_geometry", "{*}instance_controller"))
            drawn[at] = own + sum(drawn[one] for one in _named(nodes[at], nodes))
            if drawn[at] > MAX_DRAWN:
                raise DrawnTooOften


def _named(node: Element, nodes: Mapping[str, Element]) -> Iterator[str]:
    for instance in node.iter("{*}instance_node"):
        if (url := instance.get("url") or "") in nodes:
            yield url
