"""Process that loads a server as a careless or hostile client does, with plain Zenoh calls.

`python -m benchmarks.hostile_client LOAD ENDPOINT` prints a line when it has connected, then loads
the server until it is terminated. Loads that stop reading stop their own process by a signal.
"""

import os
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from typing import NoReturn

import msgspec
import zenoh
from zenoh.handlers import FifoChannel, RingChannel

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.entity_messages import EntityFilters, GetEntitiesRequest
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped, Twist, Vector3
from zensim.proto.messages.telemetry_messages import GetModelsRequest
from zensim.proto.process_limits import die_with_supervisor

SERVICE = "sim/default/{}"
ROBOT = "box_bot0"
RATE_HZ = 10_000
POLL_S = 0.0005
PATTERN = "(" + "(a|b|ab)*" * 60 + ")*c"
"""Fails late in engines that backtrack."""
GARBAGE = b"\x81" + bytes(range(200))
FAR_M = 500.0
FIFTEEN_MIB = 15 << 20

Load = Callable[[zenoh.Session], None]


class Requests:
    """Requests to one service, a number of them in flight."""

    def __init__(self, name: str, payload: bytes, in_flight: int) -> None:
        self._key = SERVICE.format(name)
        self._payload = payload
        self._in_flight = in_flight

    def __call__(self, session: zenoh.Session) -> None:
        """Call until terminated."""
        replies = [self._get(session) for _ in range(self._in_flight)]
        while True:
            for index, reply in enumerate(replies):
                if self._is_over(reply):
                    replies[index] = self._get(session)
            time.sleep(POLL_S)

    def _get(self, session: zenoh.Session) -> object:
        return session.get(self._key, FifoChannel(4), payload=self._payload, timeout=60.0)

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


def ask_without_reading(session: zenoh.Session) -> None:
    """Call get_entities at a rate, whatever comes back."""
    payload = encode(GetEntitiesRequest(), Format.MSGPACK)
    key = SERVICE.format("get_entities")
    at_rate(lambda: session.get(key, RingChannel(1), payload=payload, timeout=60.0))


def put_at_rate(session: zenoh.Session, key: str, payload: bytes) -> None:
    """Publish at a rate."""
    publisher = session.declare_publisher(key)
    at_rate(lambda: publisher.put(payload))


def stop_after(session: zenoh.Session, name: str, count: int) -> None:
    """Call a service without reading, and stop this process; subscribe to all before."""
    subscriber = session.declare_subscriber("**", RingChannel(1))
    payload = encode(GetModelsRequest(), Format.MSGPACK)
    waiting = [
        session.get(SERVICE.format(name), FifoChannel(4), payload=payload) for _ in range(count)
    ]
    os.kill(os.getpid(), signal.SIGSTOP)
    del waiting, subscriber


def subscribe_and_stop(session: zenoh.Session) -> None:
    """Subscribe to everything, and stop this process."""
    stop_after(session, "info", 0)


def send_large_requests(session: zenoh.Session) -> None:
    """Send 400 requests of 15 MiB at once, again and again."""
    payload = bytes(FIFTEEN_MIB)
    while True:
        replies = [
            session.get(SERVICE.format("info"), FifoChannel(4), payload=payload, timeout=5.0)
            for _ in range(400)
        ]
        for reply in replies:
            list(reply)


def send_large_ids(session: zenoh.Session) -> None:
    """Call with request ids of nearly 4 MiB, one after the other."""
    number = 0
    while True:
        number += 1
        attachment = number.to_bytes(8, "little") * ((4 << 17) - 200)
        key = SERVICE.format("set_entity_state")
        list(session.get(key, FifoChannel(4), attachment=attachment, timeout=5.0))


def put_large(session: zenoh.Session) -> None:
    """Publish commands of 15 MiB."""
    publisher = session.declare_publisher("sim/default/drive/x/*")
    payload = bytes(FIFTEEN_MIB)
    while True:
        publisher.put(payload)
        time.sleep(POLL_S)


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
}


def main() -> None:
    """Load the server at an endpoint."""
    die_with_supervisor(os.environ)
    load, endpoint = sys.argv[1:]
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        sys.stdout.write("connected\n")
        sys.stdout.flush()
        LOADS[load](session)


if __name__ == "__main__":
    main()
