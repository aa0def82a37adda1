"""Scene states are published when a sensor is due and somebody hears them; lockstep waits."""

import msgspec
import numpy as np

from tests.models import a_box, on_ground
from tests.sim_server.fakes import CONTROL_STEPS, ServerFixture, a_server, a_spawn
from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.model_messages import Model, Sensor
from zensim.proto.messages.sensing_messages import SceneState, SensorsReply
from zensim.proto.messages.sensor_messages import ImuSensor, RaySensor
from zensim.proto.messages.telemetry_messages import Stats
from zensim.proto.network_protocols import Sample
from zensim.proto.settings.lockstep_settings import LockstepSettings, OnMiss
from zensim.proto.topic_catalog import SENSORS_REPLY
from zensim.sim_server.pacing.lockstep import Lockstep
from zensim.sim_server.runtime.loop import ServerLoop
from zensim.sim_server.runtime.sensor_sessions import find_sensor_rates


def a_lidar(rate_hz: float) -> Sensor:
    return Sensor("lidar", "ray", "base", "base", update_rate_hz=rate_hz, settings=RaySensor())


def a_sensed_box(*rates_hz: float) -> Model:
    return msgspec.structs.replace(a_box(), sensors=tuple(map(a_lidar, rates_hz)))


def a_sensed_server(
    *rates_hz: float, is_locked: bool = False, on_miss: OnMiss = "hold", factor: float = 1.0
) -> ServerFixture:
    """Make a server with one box that carries lidars."""
    server = a_server(factor=factor, cost_ns=1_000_000)
    server.parts.pacing.lockstep = Lockstep(
        LockstepSettings(lockstep=is_locked, lockstep_timeout=0.5, on_miss=on_miss)
    )
    server.loop = ServerLoop(server.parts, server.inbox, server.publisher, server.wall)
    server.world.spawn(a_spawn("b0", model=a_sensed_box(*rates_hz), base=on_ground(0.0)))
    return server


def states(server: ServerFixture) -> list[SceneState]:
    return [one for one in server.publisher.on("scene_state") if isinstance(one, SceneState)]


def start(server: ServerFixture, *names: str) -> None:
    server.inbox.sensor_processes += [(name, True) for name in names]


def reply(server: ServerFixture, name: str, state: SceneState) -> None:
    message = SensorsReply(state.epoch, state.step, messages=3, late=1)
    key = SENSORS_REPLY.key("default", name)
    server.inbox.sensor_replies.append(Sample(key, encode(message, Format.MSGPACK), ""))


def test_states_come_at_the_steps_at_which_a_sensor_is_due() -> None:
    server = a_sensed_server(10.0, 5.0)

    server.turn_for(1.05)

    assert [state.step for state in states(server)] == list(range(24, 241, 24))


def test_state_has_the_poses_of_all_entities_and_the_active_processes() -> None:
    server = a_sensed_server(10.0)
    server.world.spawn(a_spawn("b1", model=a_box(), base=on_ground(3.0)))
    start(server, "s2", "s1")

    server.turn_for(0.15)

    (state,) = states(server)
    poses = np.frombuffer(state.poses, "<f8").reshape(-1, 7)
    assert poses[:, 0].tolist() == [0.0, 3.0]
    assert state.processes == ("s1", "s2")
    assert state.roster == server.world.entities.roster_number
    assert state.time_ns == state.step * server.world.clock.step_ns


def test_no_state_is_made_without_a_subscriber() -> None:
    server = a_sensed_server(10.0)
    server.publisher.unwanted.add("scene_state")

    server.turn_for(0.5)

    assert states(server) == []


def test_no_state_is_made_without_sensors_of_sensor_processes() -> None:
    imu = Sensor("imu", "imu", "base", "base", settings=ImuSensor())
    unknown = Sensor("radar", "radar", "base", "base")

    assert find_sensor_rates([msgspec.structs.replace(a_box(), sensors=(imu, unknown))]) == set()


def test_rates_follow_the_entities() -> None:
    server = a_sensed_server(10.0)
    server.turn_for(0.15)
    server.publisher.sent.clear()

    server.world.delete("b0")
    server.turn_for(0.5)

    assert states(server) == []


def test_lockstep_waits_for_the_replies_of_active_processes() -> None:
    server = a_sensed_server(10.0, is_locked=True, on_miss="wait")
    start(server, "s1", "s2")
    server.turn_for(0.2)
    (state,) = states(server)
    reply(server, "s1", state)
    server.turn_for(0.2)
    waiting = (server.world.clock.steps, server.parts.pacing.lockstep.awaited)

    reply(server, "s2", state)
    server.turn_for(0.02)

    assert waiting == (24, ("sensors/s2",))
    assert server.world.clock.steps > 24


def test_lockstep_does_not_wait_for_a_process_that_has_gone() -> None:
    server = a_sensed_server(10.0, is_locked=True, on_miss="wait")
    start(server, "s1")
    server.turn_for(0.2)

    server.inbox.sensor_processes.append(("s1", False))
    server.turn_for(0.3)

    assert server.world.clock.steps >= 48
    assert states(server)[-1].processes == ()


def test_state_is_published_again_while_lockstep_waits() -> None:
    server = a_sensed_server(10.0, is_locked=True, on_miss="wait")
    start(server, "s1")

    server.turn_for(1.5)

    assert {state.step for state in states(server)} == {24}
    assert len(states(server)) >= 2


def test_late_process_is_missed_and_held_back_no_more() -> None:
    server = a_sensed_server(10.0, is_locked=True, on_miss="hold")
    start(server, "s1")

    server.turn_for(1.0)

    assert server.parts.pacing.lockstep.misses["sensors/s1"] >= 1
    assert server.world.clock.steps > 48


def test_fast_time_leaves_out_states_while_a_process_is_busy() -> None:
    server = a_sensed_server(0.0, factor=0.0)
    start(server, "s1")
    server.turn_for(0.3)
    (state,) = states(server)

    reply(server, "s1", state)
    server.turn_for(0.01)

    assert len(states(server)) == 2
    assert state.step == CONTROL_STEPS


def test_stats_count_what_processes_published() -> None:
    server = a_sensed_server(10.0)
    start(server, "s1")
    server.turn_for(0.15)
    reply(server, "s1", states(server)[0])

    server.turn_for(1.1)

    stats = [one for one in server.publisher.on("stats") if isinstance(one, Stats)][-1]
    assert (stats.sensor_processes, stats.sensor_messages) == (("s1",), 3)
    assert stats.late_sensor_messages == 1


def test_malformed_reply_is_dropped() -> None:
    server = a_sensed_server(10.0)
    start(server, "s1")

    server.inbox.sensor_replies.append(Sample(SENSORS_REPLY.key("default", "s1"), b"\xff", ""))
    server.turn_for(0.15)

    assert server.parts.sensors.replies == {}
