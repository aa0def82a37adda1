"""Telemetry: topics, rates and messages."""

from collections.abc import Callable

import msgspec
import pytest

from tests.models import on_ground
from tests.sim_server.fakes import (
    RecordingPublisher,
    a_server,
    a_spawn,
    a_world,
    answer_of,
    make_parts,
    names_in,
)
from zensim.proto.messages.entity_messages import GetEntitiesRequest
from zensim.proto.messages.gazebo_messages import LinkStates, ModelStates
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.proto.messages.standard_messages import Time
from zensim.proto.messages.telemetry_messages import Snapshot, Stats, WorldClock
from zensim.proto.topic_catalog import CLOCK, MODEL_STATES, SNAPSHOT, STATS, TopicSpec
from zensim.sim_server.pacing.loop_stats import LoopStats
from zensim.sim_server.runtime.world_map import make_world_map
from zensim.sim_server.runtime.world_telemetry import GETTABLE_TOPICS, WorldTelemetry
from zensim.sim_server.service_parts import Pacing, SensorProcesses
from zensim.sim_server.world.simulated_world import SimulatedWorld

SECOND = 1_000_000_000
MILLISECOND = 1_000_000
CHANGES: dict[str, Callable[[SimulatedWorld], object]] = {
    "spawn": lambda world: world.spawn(a_spawn("r1")),
    "delete": lambda world: world.delete("r0"),
    "reset": lambda world: world.reset(ResetScope.STATE),
    "place": lambda world: world.place("r0", on_ground(5.0)),
}


def make_telemetry(world: SimulatedWorld, pacing: Pacing | None = None) -> WorldTelemetry:
    parts = make_parts(world)
    world_map = make_world_map(parts, RecordingPublisher())
    return WorldTelemetry(world, pacing or parts.pacing, SensorProcesses(), world_map)


def due(telemetry: WorldTelemetry, now_ns: int) -> list[str]:
    return [topic.name for topic in telemetry.due(now_ns)]


def counts(seconds: float, *, is_paused: bool = False) -> dict[str, int]:
    """Count the messages of each topic in some wall time."""
    server = a_server("r0")
    if is_paused:
        server.world.clock.pause()
    server.turn_for(seconds)
    return {topic: len(server.publisher.on(topic)) for topic in (*GETTABLE_TOPICS, "events")}


def test_topics_are_published_at_their_rates_while_playing() -> None:
    sent = counts(5.0)

    assert sent["clock"] == pytest.approx(500, abs=10)
    assert sent["clock"] <= 501
    assert sent["snapshot"] == pytest.approx(150, abs=2)
    assert sent["stats"] == pytest.approx(5, abs=1)


def test_topics_are_published_at_2_hz_while_paused() -> None:
    sent = counts(5.0, is_paused=True)

    assert sent["clock"] == pytest.approx(10, abs=2)
    assert sent["snapshot"] == pytest.approx(10, abs=2)
    assert sent["stats"] == pytest.approx(5, abs=1)
    assert sent["events"] == 1


def test_snapshot_says_at_once_that_the_world_is_paused() -> None:
    server = a_server("r0")
    server.turn_for(0.1)
    server.publisher.sent.clear()

    server.world.clock.pause()
    server.turn_for(0.036)

    snapshot = server.publisher.on("snapshot")[-1]
    assert isinstance(snapshot, Snapshot)
    assert snapshot.state == "paused"


@pytest.mark.parametrize("change", CHANGES.values(), ids=CHANGES)
def test_snapshot_follows_a_change_at_once_while_paused(
    change: Callable[[SimulatedWorld], object],
) -> None:
    server = a_server("r0")
    server.world.clock.pause()
    server.turn_for(0.1)
    server.publisher.sent.clear()

    change(server.world)
    server.turn_for(0.036)

    snapshot = server.publisher.on("snapshot")[-1]
    assert isinstance(snapshot, Snapshot)
    assert list(snapshot.names) == names_in(server.world)
    assert snapshot.base == server.world.states().base.tobytes()


def test_topics_are_not_made_without_subscribers() -> None:
    server = a_server("r0")
    server.publisher.unwanted |= set(GETTABLE_TOPICS)

    server.turn_for(2.0)

    assert server.publisher.sent == []


def test_snapshot_is_published_at_its_rate_when_flat_out() -> None:
    server = a_server("r0", factor=0.0, cost_ns=MILLISECOND)

    server.turn_for(2.0)

    assert server.world.clock.steps == pytest.approx(2000, abs=2)
    assert len(server.publisher.on("snapshot")) == pytest.approx(60, abs=2)
    assert len(server.publisher.on("clock")) == pytest.approx(200, abs=4)


def test_snapshot_is_published_between_the_control_steps_of_a_slow_world() -> None:
    server = a_server("r0", cost_ns=25 * MILLISECOND)
    server.turn_for(2.0)
    server.publisher.sent.clear()

    server.turn_for(4.0)

    assert server.world.clock.steps <= 6 * 40
    assert 4 * 20 <= len(server.publisher.on("snapshot")) <= 4 * 30


def test_snapshot_waits_for_the_control_step_at_which_a_diverged_robot_recovers() -> None:
    world = a_world("r0")
    telemetry = make_telemetry(world)
    world.step()
    world.engine.set_base_state(world.entities.find("r0").body, on_ground(2e6))

    between = [telemetry.can_make(one) for one in (CLOCK, SNAPSHOT, MODEL_STATES)]
    frozen_between = world.divergence_guard.frozen
    while not world.is_control_step:
        world.step()

    assert between == [True, False, False]
    assert frozen_between == ()
    assert telemetry.can_make(SNAPSHOT)
    assert isinstance(telemetry.message(SNAPSHOT), Snapshot)
    assert world.divergence_guard.frozen == ("r0",)


def test_telemetry_lists_the_due_topics_after_a_change() -> None:
    world = a_world("r0")
    telemetry = make_telemetry(world)
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


def test_clock_has_time_step_and_epoch() -> None:
    world = a_world()
    world.reset(ResetScope.TIME)
    for _ in range(240):
        world.step()

    clock = make_telemetry(world).message(CLOCK)

    assert clock == WorldClock(Time(1, 80), 240, 1)


def test_stats_contain_the_loop_statistics() -> None:
    world, loop_stats = a_world("r0", "r1"), LoopStats(0)
    world.claim("a", ("r0",), "stop")
    world.claims.rejected["claims"], world.claims.taken, loop_stats.requests = 3, 4, 5
    loop_stats.note_step(simulated_ns=SECOND // 2, took_ns=2 * MILLISECOND, late_ns=MILLISECOND)
    loop_stats.slipped_ns = SECOND
    loop_stats.close_window(SECOND)

    stats = make_telemetry(world, Pacing(lambda: 0, loop_stats)).message(STATS)

    assert isinstance(stats, Stats)
    assert (stats.entities, stats.agents, stats.claimed) == (2, 1, 1)
    assert (stats.dropped, stats.commands, stats.requests) == (3, 4, 5)
    assert (stats.real_time_factor, stats.slipped_s) == (0.5, 1.0)
    assert (stats.step_time_s, stats.step_time_max_s, stats.late_max_s) == (0.002, 0.002, 0.001)


@pytest.mark.parametrize("topic", [STATS, SNAPSHOT], ids=["stats", "snapshot"])
def test_real_time_factor_is_zero_while_paused(topic: TopicSpec) -> None:
    world, loop_stats = a_world(), LoopStats(0)
    loop_stats.real_time_factor = 1.0
    world.clock.pause()

    message = make_telemetry(world, Pacing(lambda: 0, loop_stats)).message(topic)

    assert isinstance(message, (Stats, Snapshot))
    assert message.real_time_factor == 0.0


TOPICS = [("model_states", ModelStates), ("link_states", LinkStates)]


@pytest.mark.parametrize(("topic", "kind"), TOPICS)
def test_gazebo_topic_is_published_at_20_hz(topic: str, kind: type[msgspec.Struct]) -> None:
    server = a_server("r0", "r1")

    server.turn_for(1.0)

    sent = server.publisher.on(topic)
    assert 19 <= len(sent) <= 22
    assert all(isinstance(message, kind) for message in sent)


@pytest.mark.parametrize(("topic", "kind"), TOPICS)
def test_gazebo_topic_is_not_made_without_a_subscriber(
    topic: str, kind: type[msgspec.Struct]
) -> None:
    server = a_server("r0")
    server.publisher.unwanted.add(topic)

    server.turn_for(0.5)

    assert server.publisher.on(topic) == []
    assert kind.__name__ == "".join(word.capitalize() for word in topic.split("_"))


@pytest.mark.parametrize(("topic", "kind"), TOPICS)
def test_gazebo_topic_replies_to_a_get(topic: str, kind: type[msgspec.Struct]) -> None:
    server = a_server("r0")
    call = server.request(topic, GetEntitiesRequest())

    server.loop.turn()

    answer = answer_of(call, kind)
    assert getattr(answer, "name")[0].startswith("r0")  # noqa: B009
