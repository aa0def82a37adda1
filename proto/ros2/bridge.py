"""Liveliness tokens by which zenoh-bridge-ros2dds tells other bridges of its routes.

`@/<zid>/@ros2_lv`, then `/<kind>/<key>/<type>` and, for topics, `/<qos>`; slashes are `§` here.
"""

from typing import Final, Literal

import msgspec

SLASH: Final = "§"
SPACE: Final = "@ros2_lv"
BridgeKind = Literal["MP", "MS", "SS", "SC", "AS", "AC"]
"""A publisher or subscription of a topic, a server or client of a service or of an action."""
TOPIC_KINDS: Final = ("MP", "MS")
RELIABILITY: Final = {"best_effort": 0, "reliable": 1}
DURABILITY: Final = {"volatile": 0, "transient_local": 1}
KEEP_LAST: Final = 0
"""The numbers of CycloneDDS, which are not those of rmw."""


class Route(msgspec.Struct, frozen=True, kw_only=True):
    """A topic, service or action that a bridge would carry."""

    zid: str
    kind: BridgeKind
    key: str
    """As data goes by: the name without its first slash."""
    ros_type: str
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10
    type_hash: str = ""


def bridge_token(zid: str) -> str:
    """Say that there is a bridge; declare it before those of its routes."""
    return f"@/{zid}/{SPACE}"


def route_token(route: Route) -> str:
    """Write the token of a route."""
    token = "/".join((bridge_token(route.zid), route.kind, _flat(route.key), _flat(route.ros_type)))
    return f"{token}/{_qos(route)}" if route.kind in TOPIC_KINDS else token


def _flat(name: str) -> str:
    return name.replace("/", SLASH)


def _qos(route: Route) -> str:
    told = f"typehash={route.type_hash};" if route.type_hash else ""
    return ":".join(
        (
            "",
            str(RELIABILITY[route.reliability]),
            str(DURABILITY[route.durability]),
            f"{KEEP_LAST},{route.depth}",
            told,
        )
    ).removesuffix("" if told else ":")
