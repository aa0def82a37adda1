"""Process that holds sessions: `python -m tests.chaos.session_holder ENDPOINT COUNT`.

It opens sessions one after the other, prints how many were admitted and what a refusal said, and
holds them until its standard input ends.
"""

import sys

from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import BusError
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.process_limits import raise_file_limit

OPEN_TIMEOUT_S = 6.0


def main() -> None:
    """Open and hold sessions."""
    endpoint, count = sys.argv[1], int(sys.argv[2])
    raise_file_limit()
    held: list[Bus] = []
    refusal = ""
    while len(held) < count and not refusal:
        try:
            held.append(open_bus(BusConfig(connect=(endpoint,), open_timeout_s=OPEN_TIMEOUT_S)))
        except BusError as error:  # noqa: PERF203  it ends the loop
            refusal = str(error)
    sys.stdout.write(f"{len(held)} {refusal}\n")
    sys.stdout.flush()
    sys.stdin.read()


if __name__ == "__main__":
    main()
