"""`zensim serve` that reports what it used each time it starts and stops playing.

`python -m benchmarks.watched_server ARGUMENTS` takes the arguments of `zensim serve`.
"""

import os
import sys
import time

import msgspec

from zensim.deploy.cli import main
from zensim.proto.messages.simulation_messages import State
from zensim.proto.parent_death import die_with_supervisor
from zensim.sim_server.world.simulation_clock import SimulationClock


def mark(state: State) -> str:
    """Make the prefix of the line that reports a new state."""
    return f"used until {State(state).name}: "


class Usage(msgspec.Struct, frozen=True):
    """Resources used since the start [s], and number of steps."""

    steps: int
    loop_cpu_s: float
    process_cpu_s: float
    """CPU time of all threads, including the router's."""
    wall_s: float


def report_usage() -> None:
    """Report the resources that this process uses at every change of state."""
    change = SimulationClock.change_state

    def enter(clock: SimulationClock, state: State) -> None:
        change(clock, state)
        used = Usage(clock.steps, time.thread_time(), time.process_time(), time.perf_counter())
        sys.stdout.write(f"{mark(state)}{msgspec.json.encode(used).decode()}\n")
        sys.stdout.flush()

    SimulationClock.change_state = enter  # type: ignore[method-assign, assignment]


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    report_usage()
    sys.argv[1:] = ["serve", *sys.argv[1:]]
    main()
