"""Type hashes by rosbags, from interface definitions instead of structs."""

from functools import cache
from typing import Any, cast

from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from tests.proto.ros_oracle import HUMBLE


@cache
def hash_of_message(ros_type: str) -> str:
    return _store().hash_rihs01(ros_type)


@cache
def hash_of_service(service: str) -> str:
    store = _store()
    definitions = cast("dict[str, Any]", store.fielddefs)
    halves = [(Nodetype.NAME, f"{service}_{half}") for half in ("Request", "Response")]
    listed = [(Nodetype.SEQUENCE, (half, 1)) for half in halves]
    info = (Nodetype.NAME, "service_msgs/msg/ServiceEventInfo")
    event = [("info", info), ("request", listed[0]), ("response", listed[1])]
    definitions[f"{service}_Event"] = ([], event)
    three = [*halves, (Nodetype.NAME, f"{service}_Event")]
    names = ("request_message", "response_message", "event_message")
    definitions[service] = ([], list(zip(names, three, strict=True)))
    return store.hash_rihs01(service)


def _store() -> Typestore:
    """Add the names of requests and responses, and the type of char, to the types of the oracle."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.fielddefs.update(HUMBLE.fielddefs)
    for name, (constants, fields) in HUMBLE.fielddefs.items():
        if name.endswith(("_Request", "_Response")):
            store.fielddefs[name.replace("/msg/", "/srv/")] = (constants, fields)
    info = get_types_from_msg(
        "uint8 event_type\nbuiltin_interfaces/Time stamp\nuint8[16] client_gid\n"
        "int64 sequence_number",
        "service_msgs/msg/ServiceEventInfo",
    )
    store.fielddefs.update(info)
    return store
