"""An independent service client: zenoh-ros2-sdk."""

from typing import Any, TypeAlias

import numpy as np
from rosbags.interfaces import Nodetype
from zenoh_ros2_sdk import ROS2ServiceClient
from zenoh_ros2_sdk.session import ZenohSession

from tests.integration.ros_interfaces import INTERFACES
from tests.proto.ros_oracle import HUMBLE

HOST = "127.0.0.1"
OfRos: TypeAlias = Any
"""Values and descriptions of types known only at run time."""


class Client:
    """One session of the SDK."""

    def __init__(self, port: int, domain: int) -> None:
        self._port, self._domain = port, domain
        self._session = ZenohSession.get_instance(HOST, port)
        known = {name: found for name, found in HUMBLE.fielddefs.items() if "/msg/" in name}
        known.pop("sensor_msgs/msg/Range")  # The SDK has it as in humble.
        self._session.store.register(known)

    def call(
        self, name: str, kind: str, type_hash: str, fields: dict[str, OfRos], within_s: float = 60.0
    ) -> object:
        """Call a service; None without a reply in time."""
        request, response = INTERFACES[kind].replace(";", "\n").split("---")
        client = ROS2ServiceClient(
            name,
            kind.partition("@")[0],
            request,
            response,
            domain_id=self._domain,
            router_ip=HOST,
            router_port=self._port,
            type_hash=type_hash,
            timeout=within_s,
        )
        made = {
            field: self._value(description, fields.get(field))
            for field, description in self._fields(client.request_store_type)
        }
        try:
            answer = client.call(**made)
        finally:
            client.close()
        return None if answer is None else self._plain(answer, client.response_store_type)

    def close(self) -> None:
        """Close the session."""
        self._session.close()

    def _fields(self, kind: str) -> list[tuple[str, OfRos]]:
        return list(self._session.store.get_msgdef(kind).fields)

    def _value(self, description: OfRos, given: OfRos) -> OfRos:
        match description:
            case (Nodetype.NAME, str(kind)):
                values = {
                    field: self._value(inner, (given or {}).get(field))
                    for field, inner in self._fields(kind)
                }
                return self._session.store.types[kind](**values)
            case (Nodetype.SEQUENCE, ((Nodetype.NAME, str()) as inner, _)):
                return [self._value(inner, one) for one in given or []]
            case (Nodetype.SEQUENCE | Nodetype.ARRAY, ((Nodetype.BASE, (str(kind), _)), size)):
                if kind == "string":
                    return given or []
                filled = given if given is not None else [0] * size
                return np.array(filled, dtype=kind)
            case (Nodetype.BASE, (str(kind), _)):
                empty = "" if kind == "string" else False if kind == "bool" else 0
                return empty if given is None else given
        raise TypeError(description)

    def _plain(self, value: OfRos, kind: str) -> dict[str, object]:
        return {
            field: self._bare(getattr(value, field), description)
            for field, description in self._fields(kind)
        }

    def _bare(self, value: OfRos, description: OfRos) -> object:
        match description:
            case (Nodetype.NAME, str(kind)):
                return self._plain(value, kind)
            case (Nodetype.SEQUENCE, ((Nodetype.NAME, str(kind)), _)):
                return [self._plain(one, kind) for one in value]
            case (Nodetype.SEQUENCE | Nodetype.ARRAY, _):
                return list(value) if isinstance(value, list) else value.tolist()
        return value
