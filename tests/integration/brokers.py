"""A real MQTT broker on an ephemeral port, and a client that keeps what vehicles say."""

import json
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion

from tests.integration.processes import eventually, free_endpoint

WITHIN_S = 90.0
PLACES = ("/usr/sbin/mosquitto", "/usr/local/sbin/mosquitto", "/opt/homebrew/sbin/mosquitto")
"""Folders that are not on the path of every user."""
State = dict[str, Any]


class Broker:
    """Mosquitto; `start` and `kill` may be repeated."""

    def __init__(self, folder: Path) -> None:
        self.port = int(free_endpoint().rpartition(":")[2])
        self.url = f"mqtt://127.0.0.1:{self.port}"
        self._settings = folder / "mosquitto.conf"
        self._settings.write_text(f"listener {self.port} 127.0.0.1\nallow_anonymous true\n")
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, and wait until it accepts connections."""
        found = shutil.which("mosquitto") or next(one for one in PLACES if Path(one).exists())
        self._process = subprocess.Popen(
            [found, "-c", str(self._settings)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        eventually(self._accepts, WITHIN_S, "the broker")

    def kill(self) -> None:
        """End it at once."""
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None

    def _accepts(self) -> bool:
        try:
            client = Client(CallbackAPIVersion.VERSION2)
            client.connect("127.0.0.1", self.port)
        except OSError:
            return False
        client.disconnect()
        return True


@contextmanager
def serving_broker(folder: Path) -> Iterator[Broker]:
    """Run a broker, which is ended with the context."""
    broker = Broker(folder)
    broker.start()
    try:
        yield broker
    finally:
        broker.kill()


class Master:
    """Sends messages to vehicles, and keeps theirs."""

    def __init__(self, broker: Broker, root: str = "uagv/v2/zensim") -> None:
        self._root = root
        self.messages: list[tuple[str, str, State]] = []
        """Serial number, topic and message, in order."""
        self._client = Client(CallbackAPIVersion.VERSION2)
        self._client.on_message = self._keep
        self._client.on_connect = lambda client, *_: client.subscribe(f"{root}/#")
        self._client.connect("127.0.0.1", broker.port)
        self._client.loop_start()

    def close(self) -> None:
        """End the connection."""
        self._client.disconnect()
        self._client.loop_stop()

    def send(self, robot: str, topic: str, message: State | bytes) -> None:
        """Publish a message, which is for this robot."""
        if not isinstance(message, bytes):
            message = json.dumps(message | {"serialNumber": robot}).encode()
        self._client.publish(f"{self._root}/{robot}/{topic}", message)

    def list(self, robot: str, topic: str = "state") -> list[State]:
        """List the messages of a vehicle on a topic, oldest first."""
        return [one for name, kind, one in self.messages[:] if (name, kind) == (robot, topic)]

    def wait(
        self, robot: str, accept: Callable[[State], object], topic: str = "state", since: int = 0
    ) -> State:
        """Wait for a message; return it."""

        def find() -> State | None:
            return next((one for one in self.list(robot, topic)[since:] if accept(one)), None)

        try:
            return eventually(find, WITHIN_S, topic)
        except AssertionError:
            last = json.dumps(self.list(robot, topic)[-1:])
            raise AssertionError(f"no such {topic}; the last is {last}") from None

    def add(self, robot: str, topic: str, message: State) -> None:
        """Keep a message; called in the thread of the client."""
        self.messages.append((robot, topic, message))

    def _keep(self, _client: object, _userdata: object, message: MQTTMessage) -> None:
        name, topic = message.topic.rsplit("/", 2)[1:]
        try:
            self.add(name, topic, json.loads(message.payload))
        except (ValueError, RecursionError):  # sent by the test itself
            return
