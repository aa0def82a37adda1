"""Killed scripts

A script connects to a server that plays, spawns a bonded robot and steps the world, so that it is
paused. It is killed with SIGKILL between two steps. Measured is the wall time until the world plays
again, the robot that it commanded stands, and its own robot and its tokens are gone.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import zensim
from benchmarks.figures import Figure, Limit
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import open_bus
from zensim.proto.parent_death import PARENT_PID_VARIABLE

ROUNDS, ROUNDS_WHEN_SHORT = 1000, 3
START_TIMEOUT_S, HANG_S = 60.0, 30.0
POLL_S = 0.01
SLOW = 0.01
"""Speed of a robot that stands [m/s]."""
SCRIPT = """
import os, sys, zensim
from zensim.proto.parent_death import die_with_supervisor
die_with_supervisor(os.environ)
sim = zensim.connect(sys.argv[1], timeout_s=60.0)
sim.spawn("box_bot", name="own", bond=True, x=3.0, timeout_s=60.0)
robot = sim.robots["r1"]
robot.drive(0.3, 1.0)
for number, now in enumerate(sim.steps()):
    if number == 10:
        print("steps", flush=True)
"""


def rows(*, is_short: bool) -> Iterator[Figure]:
    """Kill scripts, and measure how the world recovers."""
    rounds = ROUNDS_WHEN_SHORT if is_short else ROUNDS
    with zensim.launch(rtf=1, timeout_s=START_TIMEOUT_S) as sim:
        sim.spawn("box_bot", name="r1", timeout_s=START_TIMEOUT_S)
        taken = [_run_round(sim) for _ in range(rounds)]
        with open_bus(BusConfig(connect=(sim.endpoint,))) as bus:
            left = bus.list_tokens(keys.alive_clients("default"))
            left += bus.list_tokens(keys.bonds("default"))
    hangs = sum(one is None for one in taken)
    recovered = tuple(one for one in taken if one is not None)
    yield Figure(
        what=f"rounds of {rounds} that did not recover within {HANG_S:g} s",
        unit="",
        samples=(float(hangs),),
        limit=Limit("max", "<=", 0.0),
    )
    yield Figure(
        what="from SIGKILL to the former mode, without robot and tokens of the script",
        unit="s",
        samples=recovered,
        limit=Limit("max", "<=", 2.5, is_timed=True),
    )
    yield Figure(
        what="tokens left after the last round",
        unit="",
        samples=(float(len(left)),),
        limit=Limit("max", "<=", 0.0),
    )


def _run_round(sim: zensim.Sim) -> float | None:
    """Kill one script; return the wall time until all is as before, None if it is not."""
    script = subprocess.Popen(
        [sys.executable, "-c", SCRIPT, sim.endpoint],
        stdout=subprocess.PIPE,
        env={**os.environ, PARENT_PID_VARIABLE: str(os.getpid())},
    )
    with script:
        assert script.stdout is not None
        assert script.stdout.readline() == b"steps\n"
        script.send_signal(signal.SIGKILL)
    killed_s = time.monotonic()
    while time.monotonic() - killed_s < HANG_S:
        if _is_as_before(sim):
            return time.monotonic() - killed_s
        time.sleep(POLL_S)
    return None


def _is_as_before(sim: zensim.Sim) -> bool:
    is_free = not sim.is_paused and "own" not in sim.entities
    return is_free and sim.robots["r1"].twist.speed < SLOW
