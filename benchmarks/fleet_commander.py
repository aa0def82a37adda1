"""Process that commands each robot of a fleet once a second, by puts that declare nothing.

`python -m benchmarks.fleet_commander ENDPOINT COUNT` drives box_bot0 and so on in circles, with 50
bursts a second; a line says that they begin.
"""

import os
import sys
import time
from typing import NoReturn

from benchmarks.ten_robots import CIRCLE
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.messages.standard_messages import Twist, Vector3
from zensim.proto.parent_death import die_with_supervisor
from zensim.proto.topic_catalog import CMD_VEL

BURSTS = 50
BEGINNING = "commands"
"""The line that is printed before the first command."""


def command(bus: Bus, count: int) -> NoReturn:
    """Command all robots each second until terminated."""
    watch = bus.watch_subscribers(())
    encoding = make_encoding(Twist, Format.CDR)
    keys = [CMD_VEL.key(f"box_bot{number}") for number in range(count)]
    commands = [watch.advertise(key, encoding) for key in keys]
    payload = encode(Twist(Vector3(x=CIRCLE[0]), Vector3(z=CIRCLE[1])), Format.CDR)
    sys.stdout.write(f"{BEGINNING}\n")
    sys.stdout.flush()
    burst, began_s = 0, time.monotonic()
    while True:
        for one in commands[burst % BURSTS :: BURSTS]:
            one.send(payload)
        burst += 1
        time.sleep(max(0.0, began_s + burst / BURSTS - time.monotonic()))


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    with open_bus(BusConfig(connect=(sys.argv[1],))) as connected:
        command(connected, int(sys.argv[2]))
