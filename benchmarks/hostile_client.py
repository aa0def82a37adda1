"""Process that loads a server as a careless or hostile client does, with plain Zenoh calls.

`python -m benchmarks.hostile_client LOAD ADDRESS` prints a line when it has connected, then loads
the server until it is terminated. Loads that stop reading stop their own process by a signal. The
address is an endpoint, or the join token of a user of a secured server.
"""

import json
import os
import signal
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import NoReturn

import msgspec
import zenoh
from zenoh.handlers import FifoChannel, RingChannel

from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig, Credentials
from zensim.proto.bus.zenoh_config import list_client_settings
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.join_tokens import is_join_address, read_join_address
from zensim.proto.messages.entity_messages import EntityFilters, GetEntitiesRequest
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped, Twist, Vector3
from zensim.proto.messages.telemetry_messages import GetModelsRequest
from zensim.proto.parent_death import die_with_supervisor
from zensim.proto.tls_probe import fetch_authority
from zensim.proto.topic_catalog import DRIVE_COMMAND

WORLD = "default"
ROBOT = "box_bot0"
RATE_HZ = 10_000
POLL_S = 0.0005
PATTERN = "(" + "(a|b|ab)*" * 60 + ")*c"
"""Fails late in engines that backtrack."""
GARBAGE = b"\x81" + bytes(range(200))
FAR_M = 500.0
FIFTEEN_MIB = 15 << 20
SESSIONS, DECLARATIONS = 2000, 5000
OPEN_TIMEOUT_MS = 500


@dataclass(frozen=True)
class HostileClient:
    """A session, and how to open more of them."""

    session: zenoh.Session
    config: zenoh.Config
    user: str = ""

    def key(self, service: str) -> str:
        """Make the key of a service."""
        return keys.service(WORLD, service, self.user)


Load = Callable[[HostileClient], None]


class Requests:
    """Requests to one service, a number of them in flight."""

    def __init__(self, name: str, payload: bytes, in_flight: int) -> None:
        self._name = name
        self._payload = payload
        self._in_flight = in_flight

    def __call__(self, client: HostileClient) -> None:
        """Call until terminated."""
        replies = [self._get(client) for _ in range(self._in_flight)]
        while True:
            for index, reply in enumerate(replies):
                if self._is_over(reply):
                    replies[index] = self._get(client)
            time.sleep(POLL_S)

    def _get(self, client: HostileClient) -> object:
        return client.session.get(
            client.key(self._name), FifoChannel(4), payload=self._payload, timeout=60.0
        )

    @staticmethod
    def _is_over(reply: object) -> bool:
        try:
            return reply.try_recv() is not None  # type: ignore[attr-defined]
        except zenoh.ZError:
            return True


def request(name: str, message: msgspec.Struct, in_flight: int) -> Load:
    """Make a load of requests in flight."""
    return Requests(name, encode(message, Format.MSGPACK), in_flight)


def at_rate(act: Callable[[], object]) -> NoReturn:
    """Do something ten thousand times a second."""
    due = time.perf_counter()
    while True:
        act()
        due += 1.0 / RATE_HZ
        if (wait_s := due - time.perf_counter()) > 0.0:
            time.sleep(wait_s)


def ask_without_reading(client: HostileClient) -> None:
    """Call get_entities at a rate, whatever comes back."""
    payload = encode(GetEntitiesRequest(), Format.MSGPACK)
    key = client.key("get_entities")
    at_rate(lambda: client.session.get(key, RingChannel(1), payload=payload, timeout=60.0))


def put_at_rate(client: HostileClient, key: str, payload: bytes) -> None:
    """Publish at a rate."""
    publisher = client.session.declare_publisher(key)
    at_rate(lambda: publisher.put(payload))


def stop_after(client: HostileClient, name: str, count: int) -> None:
    """Call a service without reading, and stop this process; subscribe to all before."""
    subscriber = client.session.declare_subscriber("**", RingChannel(1))
    payload = encode(GetModelsRequest(), Format.MSGPACK)
    key = client.key(name)
    waiting = [client.session.get(key, FifoChannel(4), payload=payload) for _ in range(count)]
    os.kill(os.getpid(), signal.SIGSTOP)
    del waiting, subscriber


def subscribe_and_stop(client: HostileClient) -> None:
    """Subscribe to everything, and stop this process."""
    stop_after(client, "info", 0)


def send_large_requests(client: HostileClient) -> None:
    """Send 400 requests of 15 MiB at once, again and again."""
    payload, key = bytes(FIFTEEN_MIB), client.key("info")
    while True:
        replies = [
            client.session.get(key, FifoChannel(4), payload=payload, timeout=5.0)
            for _ in range(400)
        ]
        for reply in replies:
            list(reply)


def send_large_ids(client: HostileClient) -> None:
    """Call with request ids of nearly 4 MiB, one after the other."""
    number, key = 0, client.key("set_entity_state")
    while True:
        number += 1
        attachment = number.to_bytes(8, "little") * ((4 << 17) - 200)
        list(client.session.get(key, FifoChannel(4), attachment=attachment, timeout=5.0))


def put_large(client: HostileClient) -> None:
    """Publish commands of 15 MiB, which a router lets pass by their wider key if it admits it."""
    key = DRIVE_COMMAND.key(WORLD, client.user) if client.user else "sim/default/drive/x/*"
    publisher, payload = client.session.declare_publisher(key), bytes(FIFTEEN_MIB)
    while True:
        publisher.put(payload)
        time.sleep(POLL_S)


def open_sessions(client: HostileClient) -> None:
    """Open sessions and keep them, as many as are admitted."""
    held: list[zenoh.Session] = []
    while True:
        if len(held) < SESSIONS:
            with suppress(zenoh.ZError):
                held.append(zenoh.open(client.config))
        time.sleep(POLL_S)


def declare_many(client: HostileClient) -> None:
    """Declare subscriptions, queryables and liveliness tokens, and keep them."""
    session = client.session
    held = [
        (
            session.declare_subscriber(f"flood/{number}/s", RingChannel(1)),
            session.declare_queryable(f"flood/{number}/q", RingChannel(1)),
            session.liveliness().declare_token(f"flood/{number}/t"),
        )
        for number in range(DECLARATIONS)
    ]
    while held:
        time.sleep(1.0)


DRY_RUN = SpawnEntityOrder(
    "probe",
    entity_resource=Resource("box_bot"),
    initial_pose=PoseStamped(pose=Pose(Point(FAR_M, FAR_M, 0.0))),
    dry_run=True,
)
TWIST = encode(Twist(Vector3(x=0.2), Vector3(z=0.5)), Format.CDR)
EVIL = GetEntitiesRequest(EntityFilters(PATTERN))
LOADS: dict[str, Load] = {
    "1 get_entities in flight": request("get_entities", GetEntitiesRequest(), 1),
    "16 get_entities in flight": request("get_entities", GetEntitiesRequest(), 16),
    "64 get_entities in flight": request("get_entities", GetEntitiesRequest(), 64),
    "1 get_models in flight": request("get_models", GetModelsRequest(), 1),
    "64 get_models in flight": request("get_models", GetModelsRequest(), 64),
    "1 dry run of a spawn in flight": request("spawn_entity", DRY_RUN, 1),
    "16 dry runs of spawns in flight": request("spawn_entity", DRY_RUN, 16),
    "4 costly regular expressions in flight": request("get_entities", EVIL, 4),
    "64 malformed requests in flight": Requests("get_entities", GARBAGE, 64),
    "10,000 get_entities a second, unread": ask_without_reading,
    "10,000 twists a second on one robot": partial(
        put_at_rate, key=f"{ROBOT}/cmd_vel", payload=TWIST
    ),
    "10,000 malformed twists a second": partial(
        put_at_rate, key=f"{ROBOT}/cmd_vel", payload=GARBAGE
    ),
    "10,000 malformed twists a second to all": partial(
        put_at_rate, key="*/cmd_vel", payload=GARBAGE
    ),
    "10,000 malformed drive commands a second": partial(
        put_at_rate, key="sim/default/drive/agent/command", payload=GARBAGE
    ),
    "400 requests of 15 MiB at once": send_large_requests,
    "request ids of 4 MiB": send_large_ids,
    "commands of 15 MiB": put_large,
    "stopped subscriber to everything": subscribe_and_stop,
    "stopped with 2000 unread get_models": partial(stop_after, name="get_models", count=2000),
    "2000 sessions": open_sessions,
    "5000 subscriptions, queryables and tokens": declare_many,
}


def make_config(address: str) -> tuple[zenoh.Config, str]:
    """Make the configuration of a session, and find its user."""
    at = BusConfig(connect=(address,))
    user = ""
    if is_join_address(address):
        token = read_join_address(address)
        user = token.user
        credentials = Credentials(
            user=user, password=token.password_text, authority=fetch_authority(token)
        )
        at = BusConfig(connect=(token.endpoint,), credentials=credentials)
    config = zenoh.Config()
    for path, value in list_client_settings(at).items():
        config.insert_json5(path, json.dumps(value))
    config.insert_json5("connect/timeout_ms", str(OPEN_TIMEOUT_MS))
    return config, user


def main() -> None:
    """Load the server at an address."""
    die_with_supervisor(os.environ)
    load, address = sys.argv[1:]
    config, user = make_config(address)
    with zenoh.open(config) as session:
        sys.stdout.write("connected\n")
        sys.stdout.flush()
        LOADS[load](HostileClient(session, config, user))


if __name__ == "__main__":
    main()
