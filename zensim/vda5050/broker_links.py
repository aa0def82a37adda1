"""Connections of vehicles to an MQTT broker: one each, as each has a last will; one thread."""

import selectors
import socket
import ssl
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple, cast
from urllib.parse import urlsplit

import msgspec
from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from zensim.vda5050.vehicle_reports import Message, report_connection

if TYPE_CHECKING:
    from paho.mqtt.reasoncodes import ReasonCode

    from zensim.vda5050.vda_messages import Major

KEEP_ALIVE_S: Final = 15
MISC_PERIOD_S: Final = 1.0
RETRY_S: Final = 1.0
CONNECT_TIMEOUT_S: Final = 5.0
CLOSE_S: Final = 2.0
POLL_S: Final = 0.01
CONNECTS_PER_POLL: Final = 20
SUBSCRIBED: Final = ("order", "instantActions")


class BrokerAddress(NamedTuple):
    """Where the broker is, and who logs in."""

    host: str
    port: int
    tls: ssl.SSLContext | None = None
    user: str = ""
    password: str = ""


class VehicleMessage(NamedTuple):
    """A message for a vehicle."""

    serial: str
    topic: str
    payload: bytes


def parse_broker(url: str, ca: Path | None = None) -> BrokerAddress:
    """Parse `mqtt://HOST[:PORT]`, or `mqtts://` for TLS.

    Args:
        url: Address.
        ca: PEM file of authorities that are trusted instead of those of the system.

    Raises:
        ValueError: It is something else.
        OSError: The file cannot be read.
    """
    try:
        parts, port = urlsplit(url), urlsplit(url).port
    except ValueError:
        parts, port = urlsplit(""), None
    if parts.scheme not in ("mqtt", "mqtts") or not parts.hostname or parts.password:
        raise ValueError(f"`broker` {url[:120]!r}: use mqtt://HOST:1883 or mqtts://HOST:8883")
    if parts.scheme == "mqtt":
        return BrokerAddress(parts.hostname, port or 1883)
    return BrokerAddress(parts.hostname, port or 8883, ssl.create_default_context(cafile=ca))


class _VehicleLink:
    """Connection of one vehicle."""

    def __init__(self, serial: str, prefix: str) -> None:
        self.serial, self.prefix = serial, prefix
        self.client: Client
        self.is_up = self.was_begun = False
        self.headers: dict[str, int] = {}


class BrokerLinks:
    """All connections; call `poll` again and again."""

    def __init__(
        self, address: BrokerAddress, *, topic_root: str, version: str, note: Callable[[str], None]
    ) -> None:
        """Connect nothing yet.

        Args:
            address: Where the broker is.
            topic_root: First levels of topics: interface, version, manufacturer.
            version: Version of the standard, with three numbers.
            note: Takes a line about the broker.
        """
        self._address, self._version, self._note = address, version, note
        self._major: Major = 3 if version.startswith("3") else 2
        self._root, self._manufacturer = topic_root, topic_root.rpartition("/")[2]
        self._links: dict[str, _VehicleLink] = {}
        self._inbox: list[VehicleMessage] = []
        self._connected: list[str] = []
        self._selector = selectors.DefaultSelector()
        self._prober = ThreadPoolExecutor(1, "broker")
        self._probe: Future[None] | None = None
        self._is_reachable = False
        self._retry_s = self._misc_s = 0.0
        self._problem = ""

    def add(self, serial: str) -> None:
        """Connect a vehicle, now and again after each interruption."""
        link = self._links[serial] = _VehicleLink(serial, f"{self._root}/{serial}")
        client = link.client = Client(
            CallbackAPIVersion.VERSION2,
            client_id=f"{self._manufacturer}-{serial}",
            protocol=MQTTProtocolVersion.MQTTv311,
            userdata=link,
        )
        client.connect_timeout = CONNECT_TIMEOUT_S
        if self._address.user:
            client.username_pw_set(self._address.user, self._address.password)
        if self._address.tls is not None:
            client.tls_set_context(self._address.tls)
        client.on_connect, client.on_message = self._on_connect, self._on_message
        client.on_disconnect = self._on_disconnect
        client.on_socket_open, client.on_socket_close = self._on_open, self._on_close

    def remove(self, serial: str) -> None:
        """Say that a vehicle goes offline, and end its connection."""
        if (link := self._links.pop(serial, None)) is not None and link.was_begun:
            self._publish_connection(link, "OFFLINE")
            link.client.disconnect()

    def is_ready(self, serial: str) -> bool:
        """Whether a vehicle is connected, and all that it has sent is on its way."""
        link = self._links.get(serial)
        return link is not None and link.is_up and not link.client.want_write()

    def take_connected(self) -> list[str]:
        """Take the vehicles that have been connected since the last call."""
        found, self._connected = self._connected, []
        return found

    def count(self, serial: str, topic: str) -> int:
        """Return the headerId of the last message of a vehicle on a topic, 0 without one."""
        link = self._links.get(serial)
        return 0 if link is None else link.headers.get(topic, 0)

    def publish(self, serial: str, topic: str, message: Message) -> None:
        """Publish a message with its header; without a connection it is left out."""
        if (link := self._links.get(serial)) is not None and link.is_up:
            link.client.publish(f"{link.prefix}/{topic}", self._encode(link, topic, message))
            self._watch_writes(link.client)

    def poll(self, timeout_s: float) -> list[VehicleMessage]:
        """Send and receive; return what has come."""
        self._connect_some()
        for key, events in self._selector.select(timeout_s):
            if events & selectors.EVENT_READ:
                _read(key.data)
            if key.data.want_write():
                key.data.loop_write()
            self._watch_writes(key.data)
        if (now_s := time.monotonic()) >= self._misc_s:
            self._misc_s = now_s + MISC_PERIOD_S
            for link in self._links.values():
                link.client.loop_misc()
        found, self._inbox = self._inbox, []
        return found

    def close(self) -> None:
        """Say that all vehicles go offline, and end all connections."""
        clients = [one.client for one in self._links.values()]
        for serial in list(self._links):
            self.remove(serial)
        deadline_s = time.monotonic() + CLOSE_S
        while any(map(Client.want_write, clients)) and time.monotonic() < deadline_s:
            self.poll(POLL_S)
        self._prober.shutdown(wait=False, cancel_futures=True)
        self._selector.close()

    def _encode(self, link: _VehicleLink, topic: str, message: Message) -> bytes:
        number = link.headers[topic] = link.headers.get(topic, -1) + 1
        now = datetime.now(timezone.utc).isoformat(timespec="milliseconds")
        header = {
            "headerId": number,
            "timestamp": now.replace("+00:00", "Z"),
            "version": self._version,
            "manufacturer": self._manufacturer,
            "serialNumber": link.serial,
        }
        return msgspec.json.encode(header | message)

    def _publish_connection(self, link: _VehicleLink, state: str) -> None:
        payload = self._encode(link, "connection", report_connection(self._major, state))
        link.client.publish(f"{link.prefix}/connection", payload, qos=1, retain=True)

    def _connect_some(self) -> None:
        waiting = [one for one in self._links.values() if not one.was_begun]
        if not waiting or not self._find_broker():
            return
        for link in waiting[:CONNECTS_PER_POLL]:
            broken = report_connection(self._major, "CONNECTION_BROKEN")
            will = self._encode(link, "connection", broken)
            link.client.will_set(f"{link.prefix}/connection", will, qos=1, retain=True)
            link.was_begun = True
            try:
                link.client.connect(self._address.host, self._address.port, KEEP_ALIVE_S)
            except OSError as error:
                self._lose(link, str(error))
                return

    def _find_broker(self) -> bool:
        """Whether the broker accepts connections, which another thread finds out."""
        if self._is_reachable:
            return True
        if self._probe is None:
            if time.monotonic() >= self._retry_s:
                self._probe = self._prober.submit(self._try_broker)
            return False
        if self._probe.done():
            error, self._probe = self._probe.exception(), None
            self._is_reachable = error is None
            if error is not None:
                self._report(str(error))
        return self._is_reachable

    def _try_broker(self) -> None:
        address = (self._address.host, self._address.port)
        socket.create_connection(address, CONNECT_TIMEOUT_S).close()

    def _report(self, problem: str) -> None:
        """Note why there is no connection, once, and try again later."""
        self._retry_s = time.monotonic() + RETRY_S
        if problem != self._problem:
            self._problem = problem
            self._note(f"broker {self._address.host}:{self._address.port}: {problem}; tries again")

    def _lose(self, link: _VehicleLink, problem: str) -> None:
        link.is_up = link.was_begun = self._is_reachable = False
        self._report(problem)

    def _on_connect(
        self, client: Client, link: _VehicleLink, _flags: object, reason: "ReasonCode", _: object
    ) -> None:
        if reason.is_failure:
            self._report(str(reason))
            return
        if self._problem:
            self._note(f"broker {self._address.host}:{self._address.port}: connected again")
        self._problem, link.is_up = "", True
        client.subscribe([(f"{link.prefix}/{topic}", 0) for topic in SUBSCRIBED])
        self._publish_connection(link, "ONLINE")
        self._connected.append(link.serial)

    def _on_disconnect(self, _client: Client, link: _VehicleLink, *_: object) -> None:
        if link.serial in self._links:
            self._lose(link, "a connection has ended")

    def _on_message(self, _client: Client, link: _VehicleLink, message: MQTTMessage) -> None:
        topic = message.topic.rpartition("/")[2]
        self._inbox.append(VehicleMessage(link.serial, topic, bytes(message.payload)))

    def _on_open(self, client: Client, _link: object, opened: object) -> None:
        self._selector.register(cast("socket.socket", opened), selectors.EVENT_READ, client)

    def _on_close(self, _client: Client, _link: object, closed: object) -> None:
        with suppress(KeyError, ValueError):
            self._selector.unregister(cast("socket.socket", closed))

    def _watch_writes(self, client: Client) -> None:
        """Have `poll` write what the socket has not taken, or no more."""
        events = selectors.EVENT_READ | (selectors.EVENT_WRITE if client.want_write() else 0)
        opened = client.socket()
        if opened is not None and self._selector.get_key(opened).events != events:
            self._selector.modify(opened, events, client)


def _read(client: Client) -> None:
    """Read what has come; TLS may have decrypted more than one read takes."""
    client.loop_read()
    while isinstance(found := client.socket(), ssl.SSLSocket) and found.pending():
        client.loop_read()
