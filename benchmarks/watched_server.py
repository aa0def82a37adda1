"""`zensim serve` that reports what it used each time it starts and stops playing.

`python -m benchmarks.watched_server ARGUMENTS` takes the arguments of `zensim serve`. After SIGUSR1
it also reports the parts of its loop's time, from the next start on.
"""

import os
import signal
import sys
import time
from typing import Any

import msgspec

from benchmarks.part_timer import Stopwatch
from zensim.deploy.cli import main
from zensim.proto.bus import BusPublisher
from zensim.proto.messages.simulation_messages import State
from zensim.proto.process_limits import die_with_supervisor
from zensim.sim_server.physics.engine import Engine
from zensim.sim_server.runtime import loop_channels
from zensim.sim_server.runtime.loop import AgentSessions
from zensim.sim_server.world.simulated_world import SimulatedWorld
from zensim.sim_server.world.simulation_clock import SimulationClock

ENGINE_PARTS = {"step": "engine", "command": "command", "read": "read-back"}


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
    parts_s: dict[str, float]
    """CPU time of the loop by part; empty until requested."""


class UsageReporter:
    """Reports the resource usage of the world in this process."""

    def __init__(self) -> None:
        self._stopwatch = Stopwatch()
        self._is_requested = self._is_in = False
        self._enter = SimulationClock.change_state
        self._make_world = SimulatedWorld.__init__
        self._worlds: list[SimulatedWorld] = []

    def install(self) -> None:
        """Report at every change of state."""
        signal.signal(signal.SIGUSR1, lambda *_: setattr(self, "_is_requested", True))
        watch = self

        def make_world(world: SimulatedWorld, engine: Engine, **options: Any) -> None:  # noqa: ANN401
            watch._make_world(world, engine, **options)
            watch._worlds.append(world)

        def enter(clock: SimulationClock, state: State) -> None:
            if watch._is_requested and not watch._is_in:
                watch._time_parts(watch._worlds[0])
            watch._enter(clock, state)
            watch._report(clock, state)

        SimulatedWorld.__init__ = make_world  # type: ignore[method-assign, assignment]
        SimulationClock.change_state = enter  # type: ignore[method-assign, assignment]

    def _report(self, clock: SimulationClock, state: State) -> None:
        parts_s = {name: ns * 1e-9 for name, ns in self._stopwatch.spent_ns.items()}
        used = Usage(
            clock.steps,
            time.thread_time(),
            time.process_time(),
            time.perf_counter(),
            parts_s,
        )
        sys.stdout.write(f"{mark(state)}{msgspec.json.encode(used).decode()}\n")
        sys.stdout.flush()

    def _time_parts(self, world: SimulatedWorld) -> None:
        self._is_in = True
        watch, engine = self._stopwatch, world.engine
        for name, part in ENGINE_PARTS.items():
            setattr(engine, name, watch.timed(part, getattr(engine, name)))
        for owner, name, part in (
            (SimulatedWorld, "states", "read-back"),
            (SimulatedWorld, "snapshot", "messages"),
            (loop_channels, "encode", "encode"),
            (BusPublisher, "send", "put"),
            (AgentSessions, "serve", "take"),
        ):
            setattr(owner, name, watch.timed(part, getattr(owner, name)))
        received = watch.timed_each("messages", SimulatedWorld.drive_states)
        SimulatedWorld.drive_states = received  # type: ignore[method-assign]


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    UsageReporter().install()
    sys.argv[1:] = ["serve", *sys.argv[1:]]
    main()
