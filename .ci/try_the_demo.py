"""Run `make demo` until its ten robots have moved, and end it as Ctrl-C does."""

import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import suppress

import numpy as np

import zensim

ROBOTS, MOVED_M = 10, 0.2
PATIENCE_S = 120.0


def main() -> None:
    """Start the demo on free ports, wait until all robots have moved, and end it."""
    endpoint = f"tcp/127.0.0.1:{find_free_port()}"
    ports = {"ZENSIM_UP_LISTEN": endpoint, "ZENSIM_UP_PORT": "0"}
    began_s = time.monotonic()
    demo = subprocess.Popen(
        ["make", "demo"], env=os.environ | ports, start_new_session=True, stdin=subprocess.DEVNULL
    )
    try:
        wait_until_moved(endpoint)
        took_s = time.monotonic() - began_s
    finally:
        os.killpg(demo.pid, signal.SIGINT)
        demo.wait(PATIENCE_S)
    sys.stdout.write(f"{ROBOTS} robots of `make demo` moved after {took_s:.1f} s\n")


def find_free_port() -> int:
    """Find a port that nothing uses."""
    with socket.socket() as found:
        found.bind(("127.0.0.1", 0))
        return int(found.getsockname()[1])


def wait_until_moved(endpoint: str) -> None:
    """Wait until each robot is away from where it was first seen."""
    with connect(endpoint) as sim:
        sim.wait_until(lambda: len(sim.robots) == ROBOTS, PATIENCE_S, timeout_s=PATIENCE_S)
        fleet = sim.fleet(list(sim.robots))
        first = fleet.poses2d()

        def have_moved() -> bool:
            away = np.hypot(*(fleet.poses2d() - first)[:, :2].T)
            return bool((away > MOVED_M).all())

        sim.wait_until(have_moved, PATIENCE_S, timeout_s=PATIENCE_S)


def connect(endpoint: str) -> zensim.Sim:
    """Connect as soon as the server listens."""
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        with suppress(zensim.Unreachable):
            return zensim.connect(endpoint)
    return zensim.connect(endpoint)


if __name__ == "__main__":
    main()
