"""Processes that exchange the messages of a fleet, and nothing else: a floor.

`python -m benchmarks.bare_fleet server ENDPOINT COUNT` is the router. 20 times a second it
publishes the drive states of each of two pools. A pool, `python -m benchmarks.bare_fleet pool
ENDPOINT COUNT NUMBER`, takes the commands of all robots with each state, and publishes its targets.
Contents are zeros of the right size: nothing is computed, encoded or decoded.
"""

import os
import sys
import time
from typing import NoReturn

from zensim.proto.bus import Bus, BusConfig, open_bus
from zensim.proto.process_limits import die_with_supervisor
from zensim.proto.topic_catalog import CMD_VEL

POOLS, HZ = 2, 20.0
STATE_BYTES = 140
"""Size of a box_bot in a drive state: 13 numbers of its base, two of each wheel, its claim."""
TARGET_BYTES = 16
STATES, TARGETS = "bare/state/{}", "bare/targets/{}"
ENCODING = "zenoh/bytes"
COMMANDS = 8192
"""Depth of the queue, as much as a pool keeps at most."""
POLL_S = 0.002


def serve(endpoint: str, robots: int) -> NoReturn:
    """Publish states of pools, and take their targets."""
    with open_bus(BusConfig(mode="router", listen=(endpoint,))) as bus:
        publishers = [bus.advertise(STATES.format(number), ENCODING) for number in range(POOLS)]
        targets = bus.subscribe(TARGETS.format("*"), COMMANDS)
        state = bytes(robots // POOLS * STATE_BYTES)
        _print_ready()
        ticks, began_s = 0, time.monotonic()
        while True:
            targets.take()
            for publisher in publishers:
                publisher.send(state)
            ticks += 1
            time.sleep(max(0.0, began_s + ticks / HZ - time.monotonic()))


def follow(bus: Bus, robots: int, number: int) -> NoReturn:
    """Take the commands of all robots with each state, and publish targets."""
    states = bus.subscribe(STATES.format(number), 1)
    commands = bus.subscribe(CMD_VEL.key("*"), COMMANDS)
    publisher = bus.advertise(TARGETS.format(number), ENCODING)
    targets = bytes(robots // POOLS * TARGET_BYTES)
    _print_ready()
    while True:
        if states.take():
            commands.take()
            publisher.send(targets)
        time.sleep(POLL_S)


def _print_ready() -> None:
    sys.stdout.write("ready\n")
    sys.stdout.flush()


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    kind, at, count = sys.argv[1:4]
    if kind == "server":
        serve(at, int(count))
    with open_bus(BusConfig(connect=(at,))) as connected:
        follow(connected, int(count), int(sys.argv[4]))
