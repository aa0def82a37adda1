"""What plain Zenoh keeps of keys that were declared and undeclared: a floor, without zensim.

`python -m benchmarks.bare_keys [COUNT]` declares and undeclares new keys on one session of a router
in a process of its own, and prints the memory for each that both keep; then with a session that is
replaced after every thousand, as `zensim.proto.renewed_session` does.
"""

import json
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final

import psutil
import zenoh
from zenoh.handlers import RingChannel

from tests.integration.processes import free_endpoint

COUNT: Final = 12_000
WARM_UP: Final = 0.34
"""Share of the keys that come before the first reading."""
REPLACED_AFTER: Final = 1000
SETTLE_S: Final = 1.0
START_S: Final = 10.0
ROUTER: Final = "router"


def open_session(mode: str, place: str, endpoint: str) -> zenoh.Session:
    """Open a session as small as possible."""
    config = zenoh.Config()
    config.insert_json5("mode", json.dumps(mode))
    config.insert_json5(place, json.dumps([endpoint]))
    config.insert_json5("scouting/multicast/enabled", "false")
    return zenoh.open(config)


def declare_publisher(session: zenoh.Session, key: str) -> None:
    """Declare a publisher, and undeclare it."""
    session.declare_publisher(key).undeclare()


def declare_token(session: zenoh.Session, key: str) -> None:
    """Declare a liveliness token, and undeclare it."""
    session.liveliness().declare_token(key).undeclare()


def declare_subscriber(session: zenoh.Session, key: str) -> None:
    """Declare a subscriber, and undeclare it."""
    session.declare_subscriber(key, RingChannel(1)).undeclare()


def put(session: zenoh.Session, key: str) -> None:
    """Publish without a declaration."""
    session.put(key, b"")


KINDS: Final[tuple[Callable[[zenoh.Session, str], None], ...]] = (
    declare_publisher,
    declare_token,
    declare_subscriber,
    put,
)


@contextmanager
def running_router(endpoint: str) -> Iterator[psutil.Process]:
    """Run a router until the block ends."""
    command = [sys.executable, "-m", "benchmarks.bare_keys", ROUTER, endpoint]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        process.stdout.readline()
        yield psutil.Process(process.pid)
        process.kill()


def measure(
    act: Callable[[zenoh.Session, str], None], count: int, replaced_after: int
) -> tuple[float, float]:
    """Return what a key costs here and in the router [bytes]."""
    endpoint, here = free_endpoint(), psutil.Process()
    with running_router(endpoint) as router:
        session, before = open_session("client", "connect/endpoints", endpoint), (0, 0)
        for number in range(count):
            act(session, f"robot_{number}/scan")
            if number % replaced_after == replaced_after - 1:
                session.close()
                session = open_session("client", "connect/endpoints", endpoint)
            if number == int(WARM_UP * count):
                time.sleep(SETTLE_S)
                before = here.memory_info().rss, router.memory_info().rss
        time.sleep(SETTLE_S)
        after = here.memory_info().rss, router.memory_info().rss
        session.close()
    measured = count * (1.0 - WARM_UP)
    return (after[0] - before[0]) / measured, (after[1] - before[1]) / measured


def run_router(endpoint: str) -> None:
    """Route until the process is killed."""
    with open_session("router", "listen/endpoints", endpoint):
        sys.stdout.write(f"{endpoint}\n")
        sys.stdout.flush()
        sys.stdin.read()


def main() -> None:
    """Measure all kinds, and print a line each."""
    if sys.argv[1:2] == [ROUTER]:
        run_router(sys.argv[2])
        return
    count = int(sys.argv[1]) if len(sys.argv) > 1 else COUNT
    for replaced_after in (count + 1, REPLACED_AFTER):
        for act in KINDS:
            own, routers = measure(act, count, replaced_after)
            kept = "one session" if replaced_after > count else f"replaced after {replaced_after}"
            sys.stdout.write(
                f"{act.__name__:<20} {kept:<20} here {own:7.0f} B, router {routers:7.0f} B\n"
            )


if __name__ == "__main__":
    main()
