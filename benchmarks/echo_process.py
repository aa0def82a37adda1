"""Echo process: the minimum cost of a request through the network.

`python -m benchmarks.echo_process ENDPOINT` joins there.
"""

import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import NoReturn

from benchmarks.machine import ROOT
from benchmarks.ten_robots import POLL_S, poll_until
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.parent_death import die_with_supervisor

CALL = "bench/call"
SINK = "bench/sink"
PING = "bench/ping"
PONG = "bench/pong"
TEXT = "text/plain"


class Echo:
    """Client of the echo process."""

    def __init__(self, bus: Bus) -> None:
        self._bus = bus
        self._ping = bus.advertise(PING, TEXT)
        self._pong = bus.subscribe(PONG)

    def call(self) -> None:
        """Send a request, and wait for the reply."""
        if not self._bus.get(CALL, payload=b"x" * 32):
            raise TimeoutError("the echo does not answer")

    def put(self, data: bytes) -> None:
        """Send a request, and wait for its acknowledgement."""
        if not self._bus.get(SINK, payload=data):
            raise TimeoutError("the echo takes nothing")

    def ping(self) -> None:
        """Publish, and wait for the echo."""
        self._ping.send(b"x" * 52)
        poll_until(self._pong.newest, 2.0)


@contextmanager
def echo(bus: Bus) -> Iterator[Echo]:
    """Run an echo on the network of a bus."""
    command = [sys.executable, "-m", "benchmarks.echo_process", bus.endpoint]
    process = subprocess.Popen(command, cwd=ROOT)
    try:
        asker = Echo(bus)
        poll_until(lambda: bus.get(CALL) or None)
        asker.ping()
        yield asker
    finally:
        process.terminate()
        process.wait()


def _serve(endpoint: str) -> NoReturn:
    with open_bus(BusConfig(connect=(endpoint,))) as bus:
        pings, pong = bus.subscribe(PING, 64), bus.advertise(PONG, TEXT)
        calls, sink = bus.serve(CALL), bus.serve(SINK)
        while True:
            for sample in pings.take():
                pong.send(sample.payload)
            for call in calls.take():
                call.reply(call.payload, TEXT)
            for call in sink.take():
                call.reply(b"taken", TEXT)
            time.sleep(POLL_S)


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    _serve(sys.argv[1])
