"""Process with all users of a fleet: commands robots, and subscribes to all odometry and tf.

`python -m benchmarks.fleet_users ENDPOINT COUNT HZ` drives box_bot0 and so on in circles, and
publishes counts of sent and received messages on `bench/tally`: each second, and once all moved.
"""

import math
import os
import sys
import time
from typing import NoReturn

import msgspec

from benchmarks.motion import MOVES
from benchmarks.ten_robots import CIRCLE, POLL_S
from zensim.proto.bus import Bus, BusConfig, BusSubscription, open_bus
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.standard_messages import Odometry, Twist, Vector3
from zensim.proto.process_limits import die_with_supervisor
from zensim.proto.topic_catalog import CMD_VEL, ODOM, TF

TALLY = "bench/tally"
DEPTH = 262_144
PUBLISH_EVERY_S = 1.0


class Tally(msgspec.Struct):
    """Message counts since the start."""

    commands: int = 0
    odom: int = 0
    tf: int = 0
    moved: int = 0
    """Robots whose odometry has shown motion."""
    wall_s: float = 0.0
    """Monotonic time of publication."""


class FleetUsers:
    """All users of a fleet: commands, and subscriptions to odometry and tf."""

    def __init__(self, bus: Bus, publishing_bus: Bus, names: list[str]) -> None:
        self.tally = Tally()
        self._odom = bus.subscribe(ODOM.key("*"), DEPTH)
        self._tf = bus.subscribe(TF.key("*"), DEPTH)
        encoding = make_encoding(Twist, Format.CDR)
        self._cmd_vels = [publishing_bus.advertise(CMD_VEL.key(name), encoding) for name in names]
        self._stand = {ODOM.key(name) for name in names}

    def command(self) -> None:
        """Command every robot to drive in a circle."""
        linear, angular = CIRCLE
        payload = encode(Twist(Vector3(x=linear), Vector3(z=angular)), Format.CDR)
        for cmd_vel in self._cmd_vels:
            cmd_vel.send(payload)
        self.tally.commands += len(self._cmd_vels)

    def receive(self) -> None:
        """Process the received messages."""
        self.tally.tf += _count(self._tf)
        for sample in self._odom.take():
            self.tally.odom += 1
            if sample.key in self._stand:
                self._note_motion(sample.key, decode(Odometry, sample.payload, sample.encoding))

    def _note_motion(self, key: str, odom: Odometry) -> None:
        linear = odom.twist.twist.linear
        if math.hypot(linear.x, linear.y) > MOVES:
            self._stand.discard(key)
            self.tally.moved += 1


def _count(subscription: BusSubscription) -> int:
    return len(subscription.take())


def _serve(bus: Bus, publishing_bus: Bus, names: list[str], hz: float) -> NoReturn:
    users, was_all = FleetUsers(bus, publishing_bus, names), False
    publisher = bus.advertise(TALLY, "application/msgpack")
    command_s = publish_s = time.monotonic()
    while True:
        users.receive()
        now_s = time.monotonic()
        if now_s >= command_s:
            command_s = max(command_s + 1.0 / hz, now_s)
            users.command()
        is_all = users.tally.moved == len(names)
        if now_s >= publish_s or is_all > was_all:
            publish_s, was_all = now_s + PUBLISH_EVERY_S, is_all
            users.tally.wall_s = now_s
            publisher.send(msgspec.msgpack.encode(users.tally))
        time.sleep(POLL_S)


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    # A session matches each received message against all of its publishers.
    with (
        open_bus(BusConfig(connect=(sys.argv[1],))) as connected,
        connected.open_session() as publishing_bus,
    ):
        _serve(
            connected,
            publishing_bus,
            [f"box_bot{i}" for i in range(int(sys.argv[2]))],
            float(sys.argv[3]),
        )
