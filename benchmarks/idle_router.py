"""Router of a network without a simulation: the floor of what loads cost a machine.

`python -m benchmarks.idle_router ENDPOINT` listens there until it is terminated. It takes whatever
is published, and ends every query without a value.
"""

import json
import os
import sys
import time
from typing import NoReturn

import zenoh
from zenoh.handlers import RingChannel

from zensim.proto.process_limits import die_with_supervisor

EVERYTHING = "**"
POLL_S = 0.01


def main() -> NoReturn:
    """Route until terminated."""
    die_with_supervisor(os.environ)
    (endpoint,) = sys.argv[1:]
    config = zenoh.Config()
    settings = {
        "mode": "router",
        "listen/endpoints": [endpoint],
        "scouting/multicast/enabled": False,
    }
    for path, value in settings.items():
        config.insert_json5(path, json.dumps(value))
    with zenoh.open(config) as session:
        subscriber = session.declare_subscriber(EVERYTHING, RingChannel(1))
        queryable = session.declare_queryable(EVERYTHING, RingChannel(1))
        sys.stdout.write("listening\n")
        sys.stdout.flush()
        while True:
            subscriber.try_recv()
            queryable.try_recv()
            time.sleep(POLL_S)


if __name__ == "__main__":
    main()
