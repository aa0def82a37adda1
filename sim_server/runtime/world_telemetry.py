"""Messages of a world's topics, and the times at which they are due."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from typing import NamedTuple

import msgspec
import numpy as np

from zensim.proto.forward_kinematics import compute_link_states
from zensim.proto.messages.gazebo_messages import LinkStates, ModelStates
from zensim.proto.messages.simulation_messages import State
from zensim.proto.messages.standard_messages import (
    NANOSECONDS,
    OccupancyGrid,
    Point,
    Pose,
    Quaternion,
    Twist,
    Vector3,
    time_from_ns,
)
from zensim.proto.messages.telemetry_messages import Snapshot, Stats, WorldClock
from zensim.proto.rate_limiter import RateLimiter
from zensim.proto.se3 import FloatArray
from zensim.proto.stats_publisher import read_process_usage
from zensim.proto.topic_catalog import (
    CLOCK,
    LINK_STATES,
    MAP,
    MODEL_STATES,
    SNAPSHOT,
    STATS,
    WORLD_TOPICS,
    TopicSpec,
)
from zensim.sim_server.queries.frame_queries import SCOPE_SEPARATOR
from zensim.sim_server.runtime.world_map import WorldMap
from zensim.sim_server.service_parts import DeferredResponse, Pacing, SensorProcesses
from zensim.sim_server.world.entity import Entity
from zensim.sim_server.world.simulated_world import SimulatedWorld


def make_model_states(world: SimulatedWorld) -> ModelStates:
    """Make the states of all entities, in the order of spawning."""
    return ModelStates(world.entities.index.names, *_to_poses_and_twists(world.states().base))


def make_link_states(world: SimulatedWorld) -> LinkStates:
    """Make the states of all links, by entity, in the order of `Model.links`."""
    names: list[str] = []
    rows = np.zeros((sum(len(one.model.links) for one in world.entities), 13))
    start = {}
    for entity in world.entities:
        start[entity.name] = len(names)
        names.extend(entity.name + SCOPE_SEPARATOR + link.name for link in entity.model.links)
    for entities in _group_by_model(world.entities):
        first = np.array([start[entity.name] for entity in entities])
        states = _compute_link_states(world, entities)
        for number, link in enumerate(entities[0].model.links):
            rows[first + number] = states[link.name]
    return LinkStates(tuple(names), *_to_poses_and_twists(rows))


def _group_by_model(entities: Iterable[Entity]) -> list[list[Entity]]:
    # By identity: entities of one description share a model, and hashing models is slow.
    groups: dict[int, list[Entity]] = {}
    for entity in entities:
        groups.setdefault(id(entity.model), []).append(entity)
    return list(groups.values())


def _compute_link_states(
    world: SimulatedWorld, entities: Sequence[Entity]
) -> dict[str, FloatArray]:
    states, roster = world.states(), world.entities.index
    rows = [roster.row[entity.name] for entity in entities]
    first = roster.joint_start[rows]
    joints = first[:, None] + np.arange(len(entities[0].model.joints), dtype=np.intp)
    return compute_link_states(
        # Merged links are not published, and cost as much as others.
        msgspec.structs.replace(entities[0].model, frames=()),
        states.base[rows],
        states.joint_positions[joints],
        states.joint_velocities[joints],
    )


def _to_poses_and_twists(rows: FloatArray) -> tuple[tuple[Pose, ...], tuple[Twist, ...]]:
    poses, twists = [], []
    for x, y, z, qx, qy, qz, qw, vx, vy, vz, wx, wy, wz in rows.tolist():
        poses.append(Pose(Point(x, y, z), Quaternion(qx, qy, qz, qw)))
        twists.append(Twist(Vector3(vx, vy, vz), Vector3(wx, wy, wz)))
    return tuple(poses), tuple(twists)


PAUSED_HZ = 2.0
GETTABLE_TOPICS = {topic.suffix: topic for topic in WORLD_TOPICS if topic.is_gettable}


class DueTimes(NamedTuple):
    """When topics are due, and the last step that was published."""

    limiters: dict[TopicSpec, RateLimiter]
    idle: RateLimiter
    shown: tuple[int, ...]


class WorldTelemetry:
    """Makes the messages of a world's topics at their rates."""

    def __init__(
        self, world: SimulatedWorld, pacing: Pacing, sensors: SensorProcesses, world_map: WorldMap
    ) -> None:
        self._world = world
        self._pacing = pacing
        self._sensors = sensors
        self._loop_stats = pacing.loop_stats
        timed: tuple[TopicSpec, ...] = CLOCK, SNAPSHOT, MODEL_STATES, LINK_STATES
        self._limiters = {topic: RateLimiter(topic.rate_hz) for topic in timed}
        self._idle_limiter = RateLimiter(PAUSED_HZ)
        self._world_map = world_map
        self._make_message: dict[TopicSpec, Callable[[], msgspec.Struct]] = {
            CLOCK: self.clock,
            STATS: self.stats,
            SNAPSHOT: self._make_snapshot,
            MODEL_STATES: partial(make_model_states, world),
            LINK_STATES: partial(make_link_states, world),
        }
        self._shown: tuple[int, ...] = ()

    def due(self, now_ns: int) -> Iterator[TopicSpec]:
        """List the topics of motion that are due at a wall time."""
        world = self._world
        seen = (
            world.clock.epoch,
            world.clock.steps,
            world.entities.roster_number,
            world.placement_count,
            world.clock.state,
        )
        if seen == self._shown and not self._idle_limiter.is_due(now_ns):
            return
        is_playing = world.clock.state == State.PLAYING
        # ROS nodes in lockstep get it once at each control step.
        is_told = is_playing and self._pacing.answers.has_topics
        if not is_told and self._limiters[CLOCK].is_due(now_ns):
            yield CLOCK
        is_between = is_playing and not world.is_control_step
        # All bodies are read for agents at the next control step anyway.
        if is_between and not self._are_control_steps_rare():
            return
        for topic in (MODEL_STATES, LINK_STATES):
            if not is_between and self._limiters[topic].is_due(now_ns):
                yield topic
        if self._limiters[SNAPSHOT].is_due(now_ns):
            self._shown = seen
            yield SNAPSHOT

    def can_make(self, topic: TopicSpec) -> bool:
        """Whether a topic that is due can be made without a change of the world.

        It is due by wall time: what diverges between control steps is found at the next one.
        """
        world = self._world
        return topic is CLOCK or world.is_control_step or world.read_if_valid()

    def _are_control_steps_rare(self) -> bool:
        """Whether the world is so slow that snapshots are due more often than control steps."""
        world, factor = self._world, self._loop_stats.real_time_factor
        control_ns = world.control_steps * world.clock.step_ns
        return 0.0 < factor < control_ns * SNAPSHOT.rate_hz / NANOSECONDS

    def restart(self) -> None:
        """Let all topics be due, as the time by which they are published has gone back."""
        for limiter in (*self._limiters.values(), self._idle_limiter):
            limiter.reset()

    def save(self) -> DueTimes:
        """Take the times at which topics are due."""
        return DueTimes(self._limiters, self._idle_limiter, self._shown)

    def load(self, saved: DueTimes) -> None:
        """Replace the times at which topics are due."""
        self._limiters, self._idle_limiter = saved.limiters, saved.idle
        self._shown = saved.shown

    def reply(self, topic: TopicSpec) -> msgspec.Struct | DeferredResponse[OccupancyGrid]:
        """Make the reply to a get on a gettable topic."""
        return self._world_map.message() if topic is MAP else self.message(topic)

    def message(self, topic: TopicSpec) -> msgspec.Struct:
        """Make the message of a topic that is made at once."""
        return self._make_message[topic]()

    def clock(self) -> WorldClock:
        """Make the clock message."""
        world = self._world
        return WorldClock(time_from_ns(world.clock.time_ns), world.clock.steps, world.clock.epoch)

    def stats(self) -> Stats:
        """Make the statistics message."""
        world, loop_stats, engine = self._world, self._loop_stats, self._world.engine
        replies = self._sensors.replies.values()
        return Stats(
            world=world.name,
            sim_time_s=world.clock.time_ns * 1e-9,
            steps=world.clock.steps,
            real_time_factor=self._real_time_factor(),
            state=world.clock.state_name,
            entities=len(world.entities),
            agents=world.claims.agent_count,
            claimed=len(world.claims),
            step_time_s=loop_stats.step_time_s,
            step_time_max_s=loop_stats.step_time_max_s,
            late_max_s=loop_stats.late_max_s,
            slipped_s=loop_stats.slipped_ns * 1e-9,
            requests=loop_stats.requests,
            commands=world.claims.taken,
            dropped=world.claims.dropped,
            ready_s=dict(world.ready_s),
            target_real_time_factor=self._pacing.target_real_time_factor,
            awaited=self._pacing.lockstep.awaited,
            misses=self._pacing.lockstep.misses,
            kinematic=engine.kinematic_count,
            busy_max_s=loop_stats.busy_max_s,
            sensor_processes=tuple(sorted(self._sensors.active)),
            sensor_messages=sum(reply.messages for reply in replies),
            late_sensor_messages=sum(reply.late for reply in replies),
            refused=loop_stats.refused,
            accepted=loop_stats.accepted,
            joined=loop_stats.joined,
            usage=read_process_usage(),
            driven=world.claims.driven,
            agent_commands=loop_stats.commands.list_agents(),
        )

    def _make_snapshot(self) -> Snapshot:
        return self._world.snapshot(self._real_time_factor())

    def _real_time_factor(self) -> float:
        is_playing = self._world.clock.state == State.PLAYING
        return self._loop_stats.real_time_factor if is_playing else 0.0
