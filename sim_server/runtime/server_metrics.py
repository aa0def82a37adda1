"""Metrics of a server, read from the counters of its loop when they are asked for."""

import os
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass

from zensim.proto.messages.simulation_messages import State
from zensim.proto.metric_families import MetricFamily, make_counter, make_gauge, make_labelled
from zensim.sim_server.journal.server_journal import ChangeTracker
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.runtime.request_counts import RequestCounts
from zensim.sim_server.service_parts import ServerParts


@dataclass(frozen=True)
class ServerMetrics:
    """What is read; another thread reads it while the loop runs, so each read is atomic.

    Attributes:
        tracker: None without a journal.
        journal: Its folder.
    """

    parts: ServerParts
    engine: str
    requests: RequestCounts
    tracker: ChangeTracker | None = None
    journal: str = ""

    def list_metrics(self) -> Iterator[MetricFamily]:
        """List all metrics now."""
        yield from self._list_pace()
        yield from list_step_metrics(self.parts.pacing.loop_stats)
        yield from self._list_world()
        yield from self._list_commands()
        yield from self.requests.list_metrics()
        if self.tracker is not None:
            yield from self._list_journal(self.tracker)

    def _list_pace(self) -> Iterator[MetricFamily]:
        clock, pacing = self.parts.world.clock, self.parts.pacing
        is_playing = clock.state == State.PLAYING
        yield make_gauge("zensim_simulation_time_seconds", "Simulation time.", clock.time_ns * 1e-9)
        yield make_gauge(
            "zensim_real_time_factor",
            "Mean of the last second; 0 while paused.",
            pacing.loop_stats.real_time_factor if is_playing else 0.0,
        )
        yield make_gauge(
            "zensim_real_time_factor_target",
            "Target real-time factor; 0 = as fast as possible, and while paused.",
            pacing.target_real_time_factor if is_playing else 0.0,
        )

    def _list_world(self) -> Iterator[MetricFamily]:
        world = self.parts.world
        entities = tuple(world.entities.by_name.values())
        robots = [one.name for one in entities if one.model.is_robot]
        counts: dict[tuple[str, ...], float] = {
            ("robot",): len(robots),
            ("object",): len(entities) - len(robots),
        }
        yield make_labelled("zensim_entities", "gauge", "Entities by kind.", counts, "kind")
        yield make_labelled(
            "zensim_engine_info", "gauge", "Physics engine.", {(self.engine,): 1}, "engine"
        )
        claimed = sum(world.claims.agent_of(name) != "" for name in robots)
        yield make_gauge("zensim_claimed_robots", "Robots with an agent.", claimed)
        driven = sum(world.claims.is_driven(name) for name in robots)
        yield make_gauge("zensim_driven_robots", "Robots whose agent sends commands.", driven)
        yield make_gauge("zensim_agents", "Agents on the network.", len(self.parts.agents.alive))
        yield make_gauge(
            "zensim_sensor_processes",
            "Sensor processes that publish.",
            len(self.parts.sensors.active),
        )
        yield make_gauge(
            "zensim_frozen_entities",
            "Entities that diverged, and stay where they were.",
            len(world.divergence_guard.frozen),
        )

    def _list_commands(self) -> Iterator[MetricFamily]:
        claims = self.parts.world.claims
        rejected: dict[tuple[str, ...], float] = {
            (reason,): count for reason, count in tuple(claims.rejected.items())
        }
        yield make_counter(
            "zensim_commands_received_total",
            "Drive commands of agents.",
            claims.taken + sum(rejected.values()),
        )
        yield make_labelled(
            "zensim_commands_rejected_total",
            "counter",
            "Drive commands without effect, by reason.",
            rejected,
            "code",
        )
        counts = self.parts.pacing.loop_stats.commands
        yield make_counter(
            "zensim_commands_due_total", "Steps whose state an agent got.", counts.due
        )
        yield make_counter(
            "zensim_commands_taken_total", "Steps that an agent sent a command for.", counts.taken
        )
        yield make_gauge(
            "zensim_commands_least_share",
            "Least share of the commands due that an agent sent in the last second.",
            counts.least_share,
        )

    def _list_journal(self, tracker: ChangeTracker) -> Iterator[MetricFamily]:
        yield tracker.commit_times.make_family(
            "zensim_journal_commit_seconds", "Wall time of commits of the journal."
        )
        yield make_counter(
            "zensim_journal_failures_total", "Commits that failed.", tracker.failures
        )
        yield make_gauge(
            "zensim_journal_bytes", "Size of its database files.", sum_file_sizes(self.journal)
        )


def list_step_metrics(stats: LoopStats) -> Iterator[MetricFamily]:
    """List counts and times of steps."""
    yield make_counter("zensim_steps_total", "Physics steps.", stats.steps.count)
    yield stats.steps.make_family("zensim_step_duration_seconds", "Wall time of physics steps.")
    yield stats.lateness.make_family(
        "zensim_step_lateness_seconds", "Delay of steps after their deadlines."
    )
    yield make_counter(
        "zensim_late_steps_total",
        "Steps that began later than the length of a step after their deadline.",
        stats.late_steps,
    )
    yield make_counter(
        "zensim_slipped_seconds_total", "Wall time lost to overruns.", stats.slipped_ns * 1e-9
    )


def sum_file_sizes(folder: str) -> int:
    """Add the sizes of the files of a folder, without those of folders in it."""
    total = 0
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            with suppress(OSError):  # removed meanwhile
                total += entry.stat().st_size if entry.is_file() else 0
    return total
