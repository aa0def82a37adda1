"""The keys that rmw_zenoh puts data of topics on, and asks services at."""

import re
from typing import Final

import msgspec

from zensim.proto.ros2 import names

MAX_DOMAIN: Final = 232
"""ROS 2's own limit: beyond it DDS has no ports."""
OFF: Final = "off"
NO_HASH: Final = "TypeHashNotSupported"
"""What stands for the hash in humble, whose types have none."""
ANY_HASH: Final = "*"
"""Subscribes to every distribution."""
FORM: Final = re.compile("([0-9]{1,3})/(.+)/([^/]+)/([^/]+)")


class DataKey(msgspec.Struct, frozen=True):
    """What a key of data says."""

    domain: int
    name: str
    """With its namespace, as `/box_bot0/odom`."""
    ros_type: str
    type_hash: str


def data_key(domain: int, name: str, ros_type: str, type_hash: str) -> str:
    """Find where the data of a topic or service goes.

    Args:
        domain: See `check_domain`.
        name: With its namespace; its slashes stay, but for the first.
        ros_type: `pkg/msg/Name`; of a service `pkg/srv/Name`, without Request or Response.
        type_hash: See `zensim.proto.ros2.type_hash`; `NO_HASH` for humble.
    """
    return f"{domain}/{name.strip('/')}/{names.dds_type(ros_type)}/{type_hash}"


def parse_data_key(key: str) -> DataKey | None:
    """Read a key; None when it is not one of data."""
    if (found := FORM.fullmatch(key)) is None:
        return None
    domain, name, dds, type_hash = found.groups()
    ros_type = names.ros_type(dds)
    return DataKey(int(domain), f"/{name}", ros_type, type_hash) if ros_type else None


def read_domain(word: str) -> int | None:
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
