"""Process that drives box_bots in circles in one claim, as cheaply as possible.

`python -m benchmarks.circling_driver ENDPOINT COUNT` claims box_bot0 and so on, prints a line, and
replies to every drive state with the same wheel speeds. It also subscribes to the snapshots.
"""

import os
import sys
import time
from typing import NoReturn

import numpy as np

from benchmarks.ten_robots import POLL_S, poll_until
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding
from zensim.proto.messages.agent_messages import ClaimEntityRequest, DriveCommand, DriveState
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.parent_death import die_with_supervisor
from zensim.proto.service_catalog import CLAIM_ENTITY
from zensim.proto.topic_catalog import DRIVE_COMMAND, DRIVE_STATE, SNAPSHOT

WORLD, AGENT = "default", "circling"
CALL_TIMEOUT_S = 20.0
WHEEL_SPEEDS = (4.93, 6.5)
"""Left and right [rad/s]: `fleet.CIRCLE` of a box_bot."""


def drive(bus: Bus, names: tuple[str, ...]) -> NoReturn:
    """Claim robots, then drive them until terminated."""
    states = bus.subscribe(DRIVE_STATE.key(WORLD, AGENT))
    snapshots = bus.subscribe(SNAPSHOT.key(WORLD))
    encoding = make_encoding(DriveCommand, Format.MSGPACK)
    commands = bus.advertise(DRIVE_COMMAND.key(WORLD, AGENT), encoding)
    count = poll_until(lambda: _claim(bus, names), CALL_TIMEOUT_S)
    sys.stdout.write(f"claimed {count}\n")
    sys.stdout.flush()
    speeds = np.tile(WHEEL_SPEEDS, count).astype("<f8").tobytes()
    while True:
        snapshots.newest()
        sample = states.newest()
        if sample is None:
            time.sleep(POLL_S)
            continue
        state = decode(DriveState, sample.payload, sample.encoding)
        command = DriveCommand(state.epoch, state.step, state.claims, speeds)
        commands.send(encode(command, Format.MSGPACK))


def _claim(bus: Bus, names: tuple[str, ...]) -> int | None:
    """Claim robots, and return how many; None if the server has not received the token yet."""
    request = ClaimEntityRequest(AGENT, names)
    try:
        found = bus.call(CLAIM_ENTITY, request, world=WORLD, timeout_s=CALL_TIMEOUT_S)
    except ServiceError as error:
        if error.code != ResultCode.INCORRECT_STATE:
            raise
        return None
    return len(found.grants)


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    with open_bus(BusConfig(connect=(sys.argv[1],))) as connected:
        token = connected.token(keys.alive_agent(WORLD, AGENT))
        drive(connected, tuple(f"box_bot{i}" for i in range(int(sys.argv[2]))))
