"""Zenoh keys of ROS 2 topics and services in rmw_zenoh: name mangling, DDS type names, domains."""

import re
from typing import Final

import msgspec

EMPTY_CHUNK = "%"
"""The root namespace, or an empty enclave."""


def to_dds_type(ros_type: str) -> str:
    """Convert `pkg/msg/Name` to its DDS name, `pkg::msg::dds_::Name_`.

    Raises:
        ValueError: It does not have three parts.
    """
    parts = ros_type.split("/")
    if len(parts) != len(("package", "kind", "name")) or not all(parts):
        raise ValueError(f"ROS type {ros_type!r} is not valid; use 'package/msg/Name'")
    package, kind, name = parts
    return f"{package}::{kind}::dds_::{name}_"


def parse_dds_type(dds: str) -> str:
    """Convert a DDS name to `pkg/msg/Name`; empty if it is not one."""
    match dds.split("::"):
        case [package, kind, "dds_", name] if package and kind and name.endswith("_"):
            return f"{package}/{kind}/{name[:-1]}"
    return ""


def mangle_name(name: str) -> str:
    """Convert a name to one chunk of a key: `%box_bot0%odom` for `/box_bot0/odom`."""
    return name.replace("/", "%") or EMPTY_CHUNK


def demangle_name(chunk: str) -> str:
    """Convert a chunk of a key back to a name: `/box_bot0/odom` for `%box_bot0%odom`."""
    return chunk.replace("%", "/")


def qualify_name(namespace: str, name: str) -> str:
    """Join namespace and name: `/box_bot0/odom`."""
    return "/" + "/".join(part for part in (namespace.strip("/"), name.strip("/")) if part)


MAX_DOMAIN: Final = 232
"""Limit of ROS 2, due to the ports of DDS."""
OFF: Final = "off"
NO_HASH: Final = "TypeHashNotSupported"
"""Placeholder of the hash in humble, which has no type hashes."""
ANY_HASH: Final = "*"
"""Matches the hashes of all distributions."""
DATA_KEY_PATTERN: Final = re.compile("([0-9]{1,3})/(.+)/([^/]+)/([^/]+)")


class DataKey(msgspec.Struct, frozen=True):
    """Parts of the data key of a topic or service."""

    domain: int
    name: str
    """Name with namespace, as `/box_bot0/odom`."""
    ros_type: str
    type_hash: str


def make_data_key(domain: int, name: str, ros_type: str, type_hash: str) -> str:
    """Write the data key of a topic or service.

    Args:
        domain: See `check_domain`.
        name: With namespace; the first slash is removed.
        ros_type: `pkg/msg/Name`; for a service `pkg/srv/Name`, without Request or Response.
        type_hash: See `zensim.proto.ros2.type_hash`; `NO_HASH` for humble.
    """
    return f"{domain}/{name.strip('/')}/{to_dds_type(ros_type)}/{type_hash}"


def parse_data_key(key: str) -> DataKey | None:
    """Parse a data key; None if it is not one."""
    if (found := DATA_KEY_PATTERN.fullmatch(key)) is None:
        return None
    domain, name, dds, type_hash = found.groups()
    ros_type = parse_dds_type(dds)
    return DataKey(int(domain), f"/{name}", ros_type, type_hash) if ros_type else None


def parse_domain(text: str) -> int | None:
    """Parse a domain id; None for `off`.

    Raises:
        ValueError: It is neither.
    """
    if text == OFF:
        return None
    if not text.isdecimal() or not text.isascii():
        raise ValueError(f"ROS domain {text[:20]!r} is not valid; use 0 to {MAX_DOMAIN}, or {OFF}")
    return check_domain(int(text[:4]))


def check_domain(domain: int) -> int:
    """Return the domain id if it is valid.

    Raises:
        ValueError: It is negative or above 232.
    """
    if 0 <= domain <= MAX_DOMAIN:
        return domain
    raise ValueError(f"ROS domain {domain} is not valid; use 0 to {MAX_DOMAIN}")
