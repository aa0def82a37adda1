"""Liveliness tokens of zenoh-bridge-ros2dds."""

from typing import Final, Literal

import msgspec

BRIDGE_SLASH: Final = "§"
BRIDGE_TOKEN_SPACE: Final = "@ros2_lv"
BridgeKind = Literal["MP", "MS", "SS", "SC", "AS", "AC"]
"""Publisher, subscription; service server, client; action server, client."""
BRIDGE_TOPIC_KINDS: Final = ("MP", "MS")
BRIDGE_RELIABILITY: Final = {"best_effort": 0, "reliable": 1}
BRIDGE_DURABILITY: Final = {"volatile": 0, "transient_local": 1}
BRIDGE_KEEP_LAST: Final = 0
"""Numbers of CycloneDDS, which differ from those of rmw."""


class BridgeRoute(msgspec.Struct, frozen=True, kw_only=True):
    """A topic, service or action, as a bridge announces it."""

    zid: str
    kind: BridgeKind
    key: str
    """Name without the first slash."""
    ros_type: str
    reliability: Literal["reliable", "best_effort"] = "reliable"
    durability: Literal["volatile", "transient_local"] = "volatile"
    depth: int = 10
    type_hash: str = ""


def make_bridge_token(zid: str) -> str:
    """Write the token of a bridge; declare it before those of its routes."""
    return f"@/{zid}/{BRIDGE_TOKEN_SPACE}"


def make_route_token(route: BridgeRoute) -> str:
    """Write the token of a route."""
    token = "/".join(
        (
            make_bridge_token(route.zid),
            route.kind,
            _replace_slashes(route.key),
            _replace_slashes(route.ros_type),
        )
    )
    return f"{token}/{_format_bridge_qos(route)}" if route.kind in BRIDGE_TOPIC_KINDS else token


def _replace_slashes(name: str) -> str:
    return name.replace("/", BRIDGE_SLASH)


def _format_bridge_qos(route: BridgeRoute) -> str:
    type_hash = f"typehash={route.type_hash};" if route.type_hash else ""
    return ":".join(
        (
            "",
            str(BRIDGE_RELIABILITY[route.reliability]),
            str(BRIDGE_DURABILITY[route.durability]),
            f"{BRIDGE_KEEP_LAST},{route.depth}",
            type_hash,
        )
    ).removesuffix("" if type_hash else ":")
