"""Geometries of a COLLADA file, counted before its references are expanded."""

from __future__ import annotations

from typing import TYPE_CHECKING

from lxml import etree

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from lxml.etree import _Element as Element

MAX_GEOMETRY_INSTANCES = 10_000
NODE_INSTANCE_TAG = b"instance_node"


class TooManyInstances(ValueError):
    """Nodes reference each other in a cycle, or have too many geometries."""


def check_collada_instances(data: bytes) -> None:
    """Count the geometries of a COLLADA file before its references are expanded.

    Raises:
        TooManyInstances: There are more than 10,000, or references form a cycle.
        XMLSyntaxError: The bytes are not XML.
    """
    if NODE_INSTANCE_TAG not in data:
        return
    parser = etree.XMLParser(load_dtd=False, no_network=True, resolve_entities=False)
    nodes = {
        f"#{node.get('id')}": node
        for node in etree.fromstring(data, parser).iter("{*}node")
        if node.get("id")
    }
    _count_geometries(nodes)


def _count_geometries(nodes: Mapping[str, Element]) -> None:
    counts: dict[str, int] = {}
    for name in nodes:
        path = (
            [(name, iter(_list_instanced_nodes(nodes[name], nodes)))] if name not in counts else []
        )
        open_names = {name}
        while path:
            at, below = path[-1]
            inner = next((one for one in below if one not in counts), "")
            if inner in open_names:
                raise TooManyInstances
            if inner:
                open_names.add(inner)
                path.append((inner, iter(_list_instanced_nodes(nodes[inner], nodes))))
                continue
            path.pop()
            open_names.discard(at)
            own = sum(1 for _ in nodes[at].iter("{*}instance_geometry", "{*}instance_controller"))
            counts[at] = own + sum(counts[one] for one in _list_instanced_nodes(nodes[at], nodes))
            if counts[at] > MAX_GEOMETRY_INSTANCES:
                raise TooManyInstances


def _list_instanced_nodes(node: Element, nodes: Mapping[str, Element]) -> Iterator[str]:
    for instance in node.iter("{*}instance_node"):
        if (url := instance.get("url") or "") in nodes:
            yield url
