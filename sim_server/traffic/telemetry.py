"""What the world tells everybody, and when. Pure: wall time comes from outside."""

from collections.abc import Iterator

import msgspec

from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import NANOSECONDS, time_from_ns
from zensim.proto.messages.telemetry_messages import Stats, WorldClock
from zensim.sim_server.desk import Desk
from zensim.sim_server.physics.engine import SupportsTiers
from zensim.sim_server.traffic.gazebo_states import link_states, model_states

CLOCK_HZ = 100
SNAPSHOT_HZ = 30
PAUSED_HZ = 2
GAZEBO_HZ = 20
TOPICS = ("clock", "snapshot", "stats", "model_states", "link_states")
"""Topics that also answer a get with their value of now."""


class Timer:
    """Says when a topic is due in wall time."""

    def __init__(self, period_ns: int) -> None:
        self._period_ns = period_ns
        self._next_ns = 0

    def is_due(self, now_ns: int) -> bool:
        """Whether a period has passed; if so the next one starts."""
        if now_ns < self._next_ns:
            return False
        # From the old deadline where possible, so that the rate holds although polls come late.
        self._next_ns = max(self._next_ns + self._period_ns, now_ns + self._period_ns // 2)
        return True


class Telemetry:
    """Decides what is due."""

    def __init__(self, desk: Desk) -> None:
        self._desk = desk
        self._world = desk.world
        self._meter = desk.meter
        self._clock = Timer(NANOSECONDS // CLOCK_HZ)
        self._snapshot = Timer(NANOSECONDS // SNAPSHOT_HZ)
        self._gazebo = Timer(NANOSECONDS // GAZEBO_HZ)
        self._idle = Timer(NANOSECONDS // PAUSED_HZ)
        self._shown = (-1, -1, -1, -1)

    def due(self, now_ns: int) -> Iterator[str]:
        """Name the topics of motion that are due now."""
        world = self._world
        seen = (world.epoch, world.steps, world.roster_number, world.placed)
        has_changed = seen != self._shown or self._idle.is_due(now_ns)
        if has_changed and self._clock.is_due(now_ns):
            yield "clock"
        # Agents are told at the next control step: to read all back for viewers before is a waste.
        if world.state == State.PLAYING and not world.is_control_step:
            return
        if has_changed and self._gazebo.is_due(now_ns):
            yield "model_states"
            yield "link_states"
        if has_changed and self._snapshot.is_due(now_ns):
            self._shown = seen
            yield "snapshot"

    def message(self, topic: str) -> msgspec.Struct:
        """Make the message of a topic."""
        if topic == "clock":
            return self.clock()
        if topic == "snapshot":
            return self._world.snapshot(self._real_time_factor())
        if topic == "model_states":
            return model_states(self._world)
        if topic == "link_states":
            return link_states(self._world)
        return self.stats()

    def clock(self) -> WorldClock:
        """Simulation time."""
        world = self._world
        return WorldClock(time_from_ns(world.time_ns), world.steps, world.epoch)

    def stats(self) -> Stats:
        """How the loop is doing."""
        world, meter, engine = self._world, self._meter, self._world.engine
        return Stats(
            world=world.name,
            sim_time_s=world.time_ns * 1e-9,
            steps=world.steps,
            real_time_factor=self._real_time_factor(),
            state=world.state_name,
            entities=len(world.entities),
            agents=len(world.claims.agents),
            claimed=len(world.claims),
            step_time_s=meter.step_time_s,
            step_time_max_s=meter.step_time_max_s,
            late_max_s=meter.late_max_s,
            slipped_s=meter.slipped_ns * 1e-9,
            requests=meter.requests,
            commands=world.claims.taken,
            dropped=world.claims.dropped,
            ready_s=dict(world.ready_s),
            target_real_time_factor=self._desk.target_real_time_factor,
            awaited=self._desk.lockstep.awaited,
            misses=self._desk.lockstep.misses,
            kinematic=engine.kinematic_count if isinstance(engine, SupportsTiers) else 0,
            busy_max_s=meter.busy_max_s,
        )

    def _real_time_factor(self) -> float:
        is_playing = self._world.state == State.PLAYING
        return self._meter.real_time_factor if is_playing else 0.0
