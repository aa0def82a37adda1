"""Independent ROS 2 client (zenoh-ros2-sdk), controlled by lines of JSON.

`python -m tests.integration.ros_observer PORT DOMAIN [HASH]` replies to each line with a line.
"""

import json
import sys
import time
from typing import Any, TypeAlias

from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber
from zenoh_ros2_sdk.discovery import (
    get_service_names_and_types,
    get_topic_info,
    get_topic_names_and_types,
)

from tests.integration.ros_client import HOST, Client
from tests.integration.ros_interfaces import INTERFACES
from tests.proto.ros_hashes import hash_of_message
from tests.proto.ros_oracle import HUMBLE

LOOK_S = 30.0
"""A timeout: replies come when all hosts have replied."""
POLL_S = 0.01
OfRos: TypeAlias = Any
"""Values of types known only at run time."""


class Observer(Client):
    """One session of the SDK, for topics."""

    def __init__(self, port: int, domain: int, type_hash: str = "") -> None:
        """Join.

        Args:
            port: Port of the router on this host.
            domain: ROS 2 domain.
            type_hash: Hash of all types, for distributions without hashes.
        """
        super().__init__(port, domain)
        self._type_hash = type_hash
        self._at = {"domain_id": domain, "router_ip": HOST, "router_port": port}
        self._publishers: dict[tuple[str, str], ROS2Publisher] = {}
        self._subscribers: dict[str, ROS2Subscriber] = {}
        self._received: dict[str, list[object]] = {}

    def topics(self) -> dict[str, list[str]]:
        """List topics and their types, as `ros2 topic list -t`."""
        return dict(get_topic_names_and_types(**self._at, timeout=LOOK_S))

    def services(self) -> dict[str, list[str]]:
        """List services and their types, as `ros2 service list -t`."""
        return dict(get_service_names_and_types(**self._at, timeout=LOOK_S))

    def publishers(self, topic: str) -> list[dict[str, str]]:
        """List the publishers of a topic, as `ros2 topic info -v`."""
        found = get_topic_info(topic, **self._at, timeout=LOOK_S, verbose=True)
        return [vars(one) for one in found.publishers] if found else []

    def receive(self, topic: str, kind: str, count: int, within_s: float, qos: str) -> list[object]:
        """Subscribe, and return the first `count` distinct messages."""
        messages: list[object] = []
        received: dict[str, object] = {}
        subscriber = ROS2Subscriber(topic, kind, messages.append, **self._declared(kind, qos))
        deadline = time.monotonic() + within_s
        while len(received) < count and time.monotonic() < deadline:
            time.sleep(POLL_S)
            while messages:
                message = self._plain(messages.pop(0), kind)
                received[json.dumps(message)] = message
        subscriber.close()
        return [*received.values()][:count]

    def subscribe(self, topic: str, kind: str, qos: str) -> None:
        """Subscribe permanently."""
        received = self._received.setdefault(topic, [])
        self._subscribers[topic] = ROS2Subscriber(
            topic,
            kind,
            lambda message: received.append(self._plain(message, kind)),
            **self._declared(kind, qos),
        )

    def received(self, topic: str) -> list[object]:
        """List the messages received since `listen`, oldest first."""
        return list(self._received[topic])

    def publish(self, topic: str, kind: str, fields: OfRos) -> None:
        """Publish one message."""
        if (topic, kind) not in self._publishers:
            self._publishers[topic, kind] = ROS2Publisher(topic, kind, **self._declared(kind, ""))
        values = {name: self._value(what, fields.get(name)) for name, what in self._fields(kind)}
        self._publishers[topic, kind].publish(**values)

    def _declared(self, kind: str, qos: str) -> dict[str, OfRos]:
        if kind in INTERFACES:
            definition = INTERFACES[kind].replace(";", "\n")
        else:
            definition, _ = HUMBLE.generate_msgdef(kind, ros_version=2)
        return {
            **self._at,
            "msg_definition": definition,
            "type_hash": self._type_hash or hash_of_message(kind),
            "qos": qos or None,
        }


def main() -> None:
    """Execute the lines of standard input."""
    observer = Observer(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
    try:
        for line in sys.stdin:
            given = json.loads(line)
            response = getattr(observer, given.pop("do"))(**given)
            sys.stdout.write(json.dumps(response) + "\n")
            sys.stdout.flush()
    finally:
        observer.close()


if __name__ == "__main__":
    main()
