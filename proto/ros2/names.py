"""Names of ROS 2 in Zenoh keys: types as DDS calls them, and names without their slashes."""

EMPTY = "%"
"""Stands for the root namespace, and for an enclave that nobody named."""


def dds_type(ros_type: str) -> str:
    """Write `pkg/msg/Name` as DDS calls it: `pkg::msg::dds_::Name_`.

    Raises:
        ValueError: It has not three parts.
    """
    parts = ros_type.split("/")
    if len(parts) != len(("package", "kind", "name")) or not all(parts):
        raise ValueError(f"ROS type {ros_type!r} is not valid; use 'package/msg/Name'")
    package, kind, name = parts
    return f"{package}::{kind}::dds_::{name}_"


def ros_type(dds: str) -> str:
    """Read what `dds_type` writes; empty when it is not one."""
    match dds.split("::"):
        case [package, kind, "dds_", name] if package and kind and name.endswith("_"):
            return f"{package}/{kind}/{name[:-1]}"
    return ""


def mangled(name: str) -> str:
    """Write a name as one chunk of a key: `/box_bot0/odom` is `%box_bot0%odom`."""
    return name.replace("/", "%") or EMPTY


def demangled(chunk: str) -> str:
    """Read what `mangled` writes; `%` is the root, `/`."""
    return chunk.replace("%", "/")


def qualified(namespace: str, name: str) -> str:
    """Write a topic or service with its namespace: `/box_bot0/odom`; the root may be empty."""
    return "/" + "/".join(part for part in (namespace.strip("/"), name.strip("/")) if part)
