"""Zenoh keys of ROS 2 topics and services in rmw_zenoh: name mangling, DDS type names, domains."""

import re
from typing import Final

import msgspec

EMPTY_CHUNK = "%"
"""Stands for the root namespace, and for an enclave that nobody named."""


def to_dds_type(ros_type: str) -> str:
    """Write `pkg/msg/Name` as DDS calls it: `pkg::msg::dds_::Name_`.

    Raises:
        ValueError: It has not three parts.
    """
    parts = ros_type.split("/")
    if len(parts) != len(("package", "kind", "name")) or not all(parts):
        raise ValueError(f"ROS type {ros_type!r} is not valid; use 'package/msg/Name'")
    package, kind, name = parts
    return f"{package}::{kind}::dds_::{name}_"


def parse_dds_type(dds: str) -> str:
    """Read what `dds_type` writes; empty when it is not one."""
    match dds.split("::"):
        case [package, kind, "dds_", name] if package and kind and name.endswith("_"):
            return f"{package}/{kind}/{name[:-1]}"
    return ""


def mangle_name(name: str) -> str:
    """Write a name as one chunk of a key: `/box_bot0/odom` is `%box_bot0%odom`."""
    return name.replace("/", "%") or EMPTY_CHUNK


def demangle_name(chunk: str) -> str:
    """Read what `mangled` writes; `%` is the root, `/`."""
    return chunk.replace("%", "/")


def qualify_name(namespace: str, name: str) -> str:
    """Write a topic or service with its namespace: `/box_bot0/odom`; the root may be empty."""
    return "/" + "/".join(part for part in (namespace.strip("/"), name.strip("/")) if part)


MAX_DOMAIN: Final = 232
"""ROS 2's own limit: beyond it DDS has no ports."""
OFF: Final = "off"
NO_HASH: Final = "TypeHashNotSupported"
"""What stands for the hash in humble, whose types have none."""
ANY_HASH: Final = "*"
"""Subscribes to every distribution."""
DATA_KEY_PATTERN: Final = re.compile("([0-9]{1,3})/(.+)/([^/]+)/([^/]+)")


class DataKey(msgspec.Struct, frozen=True):
    """What a key of data says."""

    domain: int
    name: str
    """With its namespace, as `/box_bot0/odom`."""
    ros_type: str
    type_hash: str


def make_data_key(domain: int, name: str, ros_type: str, type_hash: str) -> str:
    """Find where the data of a topic or service goes.

    Args:
        domain: See `check_domain`.
        name: With its namespace; its slashes stay, but for the first.
        ros_type: `pkg/msg/Name`; of a service `pkg/srv/Name`, without Request or Response.
        type_hash: See `zensim.proto.ros2.type_hash`; `NO_HASH` for humble.
    """
    return f"{domain}/{name.strip('/')}/{to_dds_type(ros_type)}/{type_hash}"


def parse_data_key(key: str) -> DataKey | None:
    """Read a key; None when it is not one of data."""
    if (found := DATA_KEY_PATTERN.fullmatch(key)) is None:
        return None
    domain, name, dds, type_hash = found.groups()
    ros_type = parse_dds_type(dds)
    return DataKey(int(domain), f"/{name}", ros_type, type_hash) if ros_type else None


def parse_domain(word: str) -> int | None:
    """Read a domain as people write it; None for `off`: nothing of ROS 2.

    Raises:
        ValueError: It is neither.
    """
    if word == OFF:
        return None
    if not word.isdecimal() or not word.isascii():
        raise ValueError(f"ROS domain {word[:20]!r} is not valid; use 0 to {MAX_DOMAIN}, or {OFF}")
    return check_domain(int(word[:4]))


def check_domain(domain: int) -> int:
    """Return the domain if ROS 2 has it.

    Raises:
        ValueError: It is negative or above 232.
    """
    if 0 <= domain <= MAX_DOMAIN:
        return domain
    raise ValueError(f"ROS domain {domain} is not valid; use 0 to {MAX_DOMAIN}")
