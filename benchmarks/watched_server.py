"""`zensim serve` that says what it used each time it begins and ceases to play.

`python -m benchmarks.watched_server ARGUMENTS` takes the arguments of `zensim serve`. After
SIGUSR1 it also says where the time of its loop went, from the next beginning on.
"""

import os
import signal
import sys
import time

import msgspec

from benchmarks.stopwatch import Stopwatch
from zensim.deploy.cli import main
from zensim.proto.bus import BusPublisher
from zensim.proto.messages.simulation_messages import State
from zensim.proto.process_limits import die_with_supervisor
from zensim.sim_server.runtime import world_publisher
from zensim.sim_server.runtime.agent_sessions import AgentSessions
from zensim.sim_server.world.simulated_world import World

ENGINE_PARTS = {"step": "engine", "command": "command", "read": "read-back"}


def mark(state: State) -> str:
    """Begin the line that tells of a state that was entered."""
    return f"used until {State(state).name}: "


class Used(msgspec.Struct, frozen=True):
    """What a server has used since it began [s], and how far it got."""

    steps: int
    loop_cpu_s: float
    process_cpu_s: float
    """All threads: the loop's, and those of the router inside."""
    wall_s: float
    parts_s: dict[str, float]
    """CPU time of the loop by part; empty until asked for."""


class Watch:
    """Listens in on the one world of this process."""

    def __init__(self) -> None:
        self._stopwatch = Stopwatch()
        self._is_asked = self._is_in = False
        self._enter = World.change_state

    def install(self) -> None:
        """Hear of every change of state."""
        signal.signal(signal.SIGUSR1, lambda *_: setattr(self, "_is_asked", True))
        watch = self

        def enter(world: World, state: State) -> None:
            if watch._is_asked and not watch._is_in:
                watch._look_inside(world)
            watch._enter(world, state)
            watch._say(world, state)

        World.change_state = enter  # type: ignore[method-assign, assignment]

    def _say(self, world: World, state: State) -> None:
        parts_s = {name: ns * 1e-9 for name, ns in self._stopwatch.spent_ns.items()}
        used = Used(
            world.steps,
            time.thread_time(),
            time.process_time(),
            time.perf_counter(),
            parts_s,
        )
        sys.stdout.write(f"{mark(state)}{msgspec.json.encode(used).decode()}\n")
        sys.stdout.flush()

    def _look_inside(self, world: World) -> None:
        self._is_in = True
        watch, engine = self._stopwatch, world._engine  # noqa: SLF001  it is looked into
        for name, part in ENGINE_PARTS.items():
            setattr(engine, name, watch.timed(part, getattr(engine, name)))
        for owner, name, part in (
            (World, "reading", "read-back"),
            (World, "snapshot", "messages"),
            (world_publisher, "encode", "encode"),
            (BusPublisher, "send", "put"),
            (AgentSessions, "serve", "take"),
        ):
            setattr(owner, name, watch.timed(part, getattr(owner, name)))
        told = watch.timed_each("messages", World.drive_states)
        World.drive_states = told  # type: ignore[method-assign]


if __name__ == "__main__":
    die_with_supervisor(os.environ)
    Watch().install()
    sys.argv[1:] = ["serve", *sys.argv[1:]]
    main()
