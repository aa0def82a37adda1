"""Telemetry: what is due when, at which rates, and what it says."""

from collections.abc import Callable

import pytest

from tests.models import on_ground
from tests.sim_server.fakes import a_server, a_spawn, a_world, make_parts, names_in
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.proto.messages.standard_messages import Time
from zensim.proto.messages.telemetry_messages import Snapshot, Stats, WorldClock
from zensim.proto.topic_catalog import CLOCK, SNAPSHOT, STATS, TopicSpec
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.runtime.world_telemetry import GETTABLE_TOPICS, WorldTelemetry
from zensim.sim_server.service_parts import Pacing
from zensim.sim_server.world.simulated_world import World

SECOND = 1_000_000_000
MILLISECOND = 1_000_000
CHANGES: dict[str, Callable[[World], object]] = {
    "spawn": lambda world: world.spawn(a_spawn("r1")),
    "delete": lambda world: world.delete("r0"),
    "reset": lambda world: world.reset(ResetScope.STATE),
    "place": lambda world: world.place("r0", on_ground(5.0)),
}


def due(telemetry: WorldTelemetry, now_ns: int) -> list[str]:
    return [topic.name for topic in telemetry.due(now_ns)]


def counts(seconds: float, *, is_paused: bool = False) -> dict[str, int]:
    """Count what a loop tells in some wall time."""
    server = a_server("r0")
    if is_paused:
        server.world.clock.pause()
    server.turn_for(seconds)
    return {topic: len(server.publisher.on(topic)) for topic in (*GETTABLE_TOPICS, "events")}


def test_topics_are_told_at_their_rates_while_time_runs() -> None:
    told = counts(5.0)

    assert told["clock"] == pytest.approx(500, abs=10)
    assert told["clock"] <= 501
    assert told["snapshot"] == pytest.approx(150, abs=2)
    assert told["stats"] == pytest.approx(5, abs=1)


def test_topics_are_told_twice_a_second_while_time_stands() -> None:
    told = counts(5.0, is_paused=True)

    assert told["clock"] == pytest.approx(10, abs=2)
    assert told["snapshot"] == pytest.approx(10, abs=2)
    assert told["stats"] == pytest.approx(5, abs=1)
    assert told["events"] == 1


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_snapshot_follows_a_change_at_once_while_time_stands(
    change: Callable[[World], object],
) -> None:
    server = a_server("r0")
    server.world.clock.pause()
    server.turn_for(0.1)
    server.publisher.told.clear()

    change(server.world)
    server.turn_for(0.036)

    snapshot = server.publisher.on("snapshot")[-1]
    assert isinstance(snapshot, Snapshot)
    assert list(snapshot.names) == names_in(server.world)
    assert snapshot.base == server.world.states().base.tobytes()


def test_topics_are_not_made_when_nobody_listens() -> None:
    server = a_server("r0")
    server.publisher.unwanted = set(GETTABLE_TOPICS)

    server.turn_for(2.0)

    assert server.publisher.told == []


def test_snapshot_comes_as_often_as_can_be_when_flat_out() -> None:
    server = a_server("r0", factor=0.0, cost_ns=MILLISECOND)

    server.turn_for(2.0)

    assert server.world.clock.steps == pytest.approx(2000, abs=2)
    assert len(server.publisher.on("snapshot")) == pytest.approx(60, abs=2)
    assert len(server.publisher.on("clock")) == pytest.approx(200, abs=4)


def test_telemetry_tells_clock_and_where_everything_is_when_something_has_changed() -> None:
    world = a_world("r0")
    telemetry = WorldTelemetry(world, make_parts(world).pacing)
    for i in range(5):
        due(telemetry, SECOND + i * 100 * MILLISECOND)
    nothing = due(telemetry, SECOND + 500 * MILLISECOND)

    world.step()
    between = due(telemetry, SECOND + 501 * MILLISECOND)
    while not world.is_control_step:
        world.step()

    assert nothing == []
    assert between == ["clock"]
    assert due(telemetry, SECOND + 511 * MILLISECOND) == [
        "clock",
        "model_states",
        "link_states",
        "snapshot",
    ]


def test_clock_tells_time_step_and_epoch() -> None:
    world = a_world()
    world.reset(ResetScope.TIME)
    for _ in range(240):
        world.step()

    clock = WorldTelemetry(world, make_parts(world).pacing).message(CLOCK)

    assert clock == WorldClock(Time(1, 80), 240, 1)


def test_stats_tell_how_the_loop_is_doing() -> None:
    world, meter = a_world("r0", "r1"), LoopStats(0)
    world.claim("a", ("r0",), "stop")
    world.claims.dropped, world.claims.taken, meter.requests = 3, 4, 5
    meter.note_step(simulated_ns=SECOND // 2, took_ns=2 * MILLISECOND, late_ns=MILLISECOND)
    meter.slipped_ns = SECOND
    meter.close_window(SECOND)

    stats = WorldTelemetry(world, Pacing(lambda: 0, meter)).message(STATS)

    assert isinstance(stats, Stats)
    assert (stats.entities, stats.agents, stats.claimed) == (2, 1, 1)
    assert (stats.dropped, stats.commands, stats.requests) == (3, 4, 5)
    assert (stats.real_time_factor, stats.slipped_s) == (0.5, 1.0)
    assert (stats.step_time_s, stats.step_time_max_s, stats.late_max_s) == (0.002, 0.002, 0.001)


@pytest.mark.parametrize("topic", [STATS, SNAPSHOT], ids=["stats", "snapshot"])
def test_real_time_factor_is_zero_while_time_stands(topic: TopicSpec) -> None:
    world, meter = a_world(), LoopStats(0)
    meter.real_time_factor = 1.0
    world.clock.pause()

    message = WorldTelemetry(world, Pacing(lambda: 0, meter)).message(topic)

    assert isinstance(message, (Stats, Snapshot))
    assert message.real_time_factor == 0.0
