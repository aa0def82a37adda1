"""Fuzzer of a running server's network: damaged requests and samples on all of its keys.

`python -m tests.hostile.message_fuzz [--messages N] [--seed S]` sends them beside a robot that
drives. Another client calls `info` after each hundred: 99 of 100 calls must be answered within 50
ms. In the end the server and the agent must run, and the robot must drive when it is put on its
wheels: valid twists among the damaged ones let it tip over.
"""

import argparse
import random
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field

import zenoh
from zenoh.handlers import FifoChannel

from benchmarks.figures import quantile
from tests.hostile.fuzz import damage_bytes
from tests.integration.processes import Server, eventually, running_agents, serving
from tests.integration.robots import robot
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, encode, supports_format
from zensim.proto.messages.entity_messages import EntityState
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.messages.standard_messages import Point, Pose
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.service_catalog import SERVICES
from zensim.proto.topic_catalog import CMD_VEL, DRIVE_COMMAND, SENSORS_REPLY, TWISTS, TopicSpec

MESSAGES = 1_000_000
MOST_P99_S = 0.05
BATCH = 100
MAX_IN_FLIGHT = 64
REPLY_TIMEOUT_S = 2.0
REQUEST_SHARE = 0.3
ROBOT, WORLD = "r1", "default"
FREE_PLACE = Point(-500.0, -500.0, 0.1)
"""Far from what has been spawned."""
DECISIVE = {
    *("set_simulation_state", "load_world", "unload_world", "reset_simulation", "reset_world"),
    *("pause_physics", "set_speed", "gazebo_reset_simulation"),
}
"""Services that end or empty the world, or hold it, where the damage leaves a valid request."""
LEFT_OUT = {*DECISIVE, "step_simulation", "simulate_steps", "run_to"}
TOPICS: tuple[tuple[TopicSpec, str], ...] = (
    (DRIVE_COMMAND, DRIVE_COMMAND.key(WORLD, "fuzz")),
    (DRIVE_COMMAND, DRIVE_COMMAND.key(WORLD, ROBOT)),
    (TWISTS, TWISTS.key(WORLD)),
    (SENSORS_REPLY, SENSORS_REPLY.key(WORLD, "fuzz")),
    (CMD_VEL, CMD_VEL.key(ROBOT)),
)


@dataclass
class MessageFuzzer:
    """A client that sends damaged messages."""

    session: zenoh.Session
    chance: random.Random
    requests: list[tuple[str, bytes, str]] = field(default_factory=list)
    samples: list[tuple[str, bytes, str]] = field(default_factory=list)
    in_flight: "deque[zenoh.handlers.Handler[zenoh.Reply]]" = field(default_factory=deque)

    def __post_init__(self) -> None:
        for name, service in SERVICES.items():
            if name not in LEFT_OUT:
                key = keys.service(WORLD, name)
                self.requests += [(key, *one) for one in _encode_samples(service.request)]
        for topic, key in TOPICS:
            for kind in topic.messages:
                self.samples += [(key, *one) for one in _encode_samples(kind)]

    def send(self) -> None:
        """Send one damaged message; wait for an old reply if many are outstanding."""
        is_request = self.chance.random() < REQUEST_SHARE
        key, payload, encoding = self.chance.choice(self.requests if is_request else self.samples)
        payload = damage_bytes(payload, self.chance)
        if not is_request:
            self.session.put(key, payload, encoding=encoding)
            return
        reply = self.session.get(
            key, FifoChannel(4), payload=payload, encoding=encoding, timeout=REPLY_TIMEOUT_S
        )
        self.in_flight.append(reply)
        if len(self.in_flight) > MAX_IN_FLIGHT:
            list(self.in_flight.popleft())


def _encode_samples(kind: type) -> Iterator[tuple[bytes, str]]:
    """Encode a sample of a message in each format, also with a wrong or no name of the format."""
    for format_ in Format:
        if supports_format(kind, format_):
            payload = encode(make_sample_message(kind), format_)
            yield from ((payload, encoding) for encoding in ("", *(one.value for one in Format)))


def fuzz_messages(messages: int, seed: int) -> list[float]:
    """Send damaged messages to a server of their own; return the times of `info` [s].

    Raises:
        AssertionError: The server or its robot does not go on.
    """
    with serving() as server:
        server.client.spawn(SpawnEntityOrder(ROBOT, entity_resource=Resource("box_bot")))
        with running_agents(server, ROBOT) as agents, _open_session(server) as session:
            fuzzer, times_s = MessageFuzzer(session, random.Random(seed)), []
            for number in range(messages):
                fuzzer.send()
                if number % BATCH == 0:
                    times_s.append(_time_info(server))
            assert server.process.poll() is None
            assert agents[ROBOT].poll() is None
            _require_driving(server)
    return times_s


def _time_info(server: Server) -> float:
    begin_s = time.perf_counter()
    server.client.info()
    return time.perf_counter() - begin_s


def _require_driving(server: Server) -> None:
    """Put the robot on its wheels and drive it."""
    with suppress(ServiceError):  # it plays already, most likely
        server.client.set_simulation_state(State.PLAYING)
    server.client.set_entity_state(ROBOT, EntityState(pose=Pose(FREE_PLACE)))
    driven = robot(server.bus, ROBOT)

    def is_driving() -> bool:
        driven.command(0.3)
        driven.read()
        return driven.last is not None and driven.last.twist.twist.linear.x > 0.1

    eventually(is_driving, 20.0, "driving")


@contextmanager
def _open_session(server: Server) -> Iterator[zenoh.Session]:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{server.endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        yield session


def main() -> None:
    """Fuzz a server; print the times of `info`; exit with 1 if they are too long."""
    parser = argparse.ArgumentParser(prog="python -m tests.hostile.message_fuzz")
    parser.add_argument("--messages", type=int, default=MESSAGES)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    began_s = time.perf_counter()
    times_s = sorted(fuzz_messages(given.messages, given.seed))
    p99_s = quantile(times_s, 0.99)
    print(  # noqa: T201
        f"{given.messages} messages in {time.perf_counter() - began_s:.0f} s; info: median "
        f"{quantile(times_s, 0.5) * 1e3:.1f}, p99 {p99_s * 1e3:.1f}, max {times_s[-1] * 1e3:.1f} ms"
    )
    raise SystemExit(p99_s > MOST_P99_S)


if __name__ == "__main__":
    main()
