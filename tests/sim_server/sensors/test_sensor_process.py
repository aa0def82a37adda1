"""A sensor process publishes its share of the sensors that have subscribers, and nothing else."""

from hashlib import sha256

import numpy as np
import pytest

from tests.sim_server.sensors.sensed_worlds import (
    NOISE,
    STEP_NS,
    WORLD,
    SensedWorld,
    a_lidar,
    a_robot,
    a_wall,
    at,
    scans_of,
)
from zensim.proto import keys
from zensim.proto.codec.message_codec import Format, decode
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.messages.sensing_messages import SceneState, SensorsReply, SensorStats
from zensim.proto.messages.standard_messages import LaserScan, time_from_ns
from zensim.proto.ros2.ros_settings import RosSettings
from zensim.proto.stl import write_corners
from zensim.proto.topic_catalog import SCENE_STATE, SENSOR_STATS, SENSORS_REPLY
from zensim.sim_server.sensors import ray_sensors


@pytest.fixture
def world() -> SensedWorld:
    """Two robots before a wall."""
    world = SensedWorld()
    world.spawn("wall", a_wall(5.0), at(0.0))
    world.spawn("r1", a_robot(), at(0.0))
    world.spawn("r2", a_robot(), at(-2.0))
    return world


def test_scan_has_the_ranges_of_what_its_robot_sees(world: SensedWorld) -> None:
    world.start("s1")
    heard = world.listen("*/scan")

    world.step_to(24)

    scans = dict(scans_of(heard))
    assert scans["r1/scan"].ranges == pytest.approx((5.0, np.inf, 1.9, np.inf))
    assert scans["r2/scan"].ranges == pytest.approx((1.9, np.inf, np.inf, np.inf))
    assert scans["r1/scan"].header.frame_id == "base"
    assert scans["r1/scan"].header.stamp == time_from_ns(24 * STEP_NS)


def test_process_subscribes_to_nothing_while_nobody_listens(world: SensedWorld) -> None:
    process = world.start("s1")

    assert not process.is_active
    assert world.list_active() == ()
    assert not world.bus.has_subscriber(f"sim/{WORLD}/scene_state")


def test_process_ends_its_subscription_some_time_after_the_last_listener(
    world: SensedWorld,
) -> None:
    process = world.start("s1")
    heard = world.listen("r1/scan")
    was_active = process.is_active

    heard.close()
    world.run(3.0)

    assert was_active
    assert not process.is_active


def test_process_that_is_always_on_subscribes_at_once(world: SensedWorld) -> None:
    assert world.start("s1", is_always_on=True).is_active


def test_only_robots_with_listeners_are_measured(world: SensedWorld) -> None:
    process = world.start("s1")
    heard = world.listen("r2/scan")
    # A publisher counts as matched until it is checked.
    world.step_to(24)
    world.run(0.2)
    before = process.counts.total

    world.step_to(48)

    assert [key for key, _ in scans_of(heard)] == ["r2/scan"] * 2
    assert process.counts.total == before + 1


def test_sensors_of_other_rates_are_published_when_they_are_due(world: SensedWorld) -> None:
    world.spawn("r3", a_robot(a_lidar(rate_hz=5.0), a_lidar("rear", rate_hz=20.0)), at(3.0))
    world.start("s1")
    heard = world.listen("r3/**")

    for step in (12, 24, 36, 48):
        world.step_to(step)

    keys_heard = [key for key, _ in scans_of(heard)]
    assert keys_heard.count("r3/scan") == 1
    assert keys_heard.count("r3/rear/scan") == 4


def test_processes_share_the_sensors_evenly(world: SensedWorld) -> None:
    processes = [world.start("s1"), world.start("s2")]
    heard = world.listen("*/scan")

    world.step_to(24)

    assert sorted(key for key, _ in scans_of(heard)) == ["r1/scan", "r2/scan"]
    assert [process.counts.total for process in processes] == [1, 1]


def test_share_of_a_process_that_ended_goes_to_the_others(world: SensedWorld) -> None:
    world.start("s1")
    world.start("s2")
    heard = world.listen("*/scan")
    world.step_to(24)
    scans_of(heard)

    world.kill("s1")
    world.step_to(48)

    assert sorted(key for key, _ in scans_of(heard)) == ["r1/scan", "r2/scan"]


def record_noisy_scans(*processes: str) -> dict[str, list[bytes]]:
    world = SensedWorld()
    world.spawn("wall", a_wall(5.0), at(0.0))
    for number in range(5):
        world.spawn(f"r{number}", a_robot(a_lidar(noise=NOISE)), at(-float(number), 0.1 * number))
    for name in processes:
        world.start(name)
    heard = world.listen("*/scan")
    for step in range(24, 240, 24):
        world.step_to(step)
    found: dict[str, list[bytes]] = {}
    for sample in heard.take():
        found.setdefault(sample.key, []).append(sample.payload)
    return found


def test_bytes_are_the_same_whoever_measures() -> None:
    alone = record_noisy_scans("s1")

    assert record_noisy_scans("b", "a") == alone
    assert {len(payloads) for payloads in alone.values()} == {9}
    assert len({payload for payloads in alone.values() for payload in payloads}) == 45


def test_bytes_are_the_same_in_blocks_of_any_size(monkeypatch: pytest.MonkeyPatch) -> None:
    together = record_noisy_scans("s1")

    monkeypatch.setattr(ray_sensors, "RAYS_AT_ONCE", 1)

    assert record_noisy_scans("s1") == together


def test_bytes_are_the_same_for_a_single_listener() -> None:
    world = SensedWorld()
    world.spawn("wall", a_wall(5.0), at(0.0))
    for number in range(5):
        world.spawn(f"r{number}", a_robot(a_lidar(noise=NOISE)), at(-float(number), 0.1 * number))
    world.start("s1")
    heard = world.listen("r3/scan")
    world.step_to(24)

    assert [one.payload for one in heard.take()] == record_noisy_scans("s1")["r3/scan"][:1]


def test_new_robot_is_seen_and_sees_in_the_next_state(world: SensedWorld) -> None:
    world.start("s1")
    heard = world.listen("*/scan")
    world.step_to(24)
    scans_of(heard)

    world.spawn("r3", a_robot(), at(2.0))
    world.step_to(48)

    scans = dict(scans_of(heard))
    assert scans["r1/scan"].ranges[0] == pytest.approx(1.9)
    assert scans["r3/scan"].ranges[0] == pytest.approx(3.0)


def test_reply_follows_the_measurements_of_a_state(world: SensedWorld) -> None:
    world.start("s1")
    everything = world.listen("**")
    everything.take()

    world.step_to(24)

    samples = [one for one in everything.take() if "scene_state" not in one.key]
    assert [one.key for one in samples][-1] == SENSORS_REPLY.key(WORLD, "s1")
    reply = decode(SensorsReply, samples[-1].payload, samples[-1].encoding)
    assert (reply.epoch, reply.step, reply.messages, reply.late) == (0, 24, 2, 0)


def test_state_that_comes_again_is_answered_again_and_not_measured(world: SensedWorld) -> None:
    world.start("s1")
    replies = world.bus.subscribe(SENSORS_REPLY.key(WORLD, "s1"), 10)
    heard = world.listen("r1/scan")

    world.step_to(24)
    world.step_to(24)

    assert len(replies.take()) == 2
    assert len(heard.take()) == 1


def test_steps_of_a_new_epoch_are_not_stale(world: SensedWorld) -> None:
    world.start("s1")
    heard = world.listen("r1/scan")

    world.step_to(480)
    world.step_to(24, epoch=1)
    world.step_to(504, epoch=0)

    stamps = [scan.header.stamp for _, scan in scans_of(heard)]
    assert stamps == [time_from_ns(480 * STEP_NS), time_from_ns(24 * STEP_NS)]


def test_measurements_that_came_late_or_not_are_counted(world: SensedWorld) -> None:
    process = world.start("s1")
    world.listen("r1/scan")
    world.step_to(24)
    world.run(0.2)
    late_before = process.counts.total_late

    world.publish(48)
    world.publish(72)
    world.run(0.03)
    world.step_to(144)

    # Step 48 was late; 96 and 120 never came.
    assert process.counts.total_late - late_before == 3


def test_stats_tell_what_each_sensor_published(world: SensedWorld) -> None:
    world.start("s1")
    world.listen("r1/scan")
    world.step_to(24)
    world.bus.pumps.append(lambda: world.run(0.05))

    (sample,) = world.bus.get(SENSOR_STATS.key(WORLD, "*"))

    stats = decode(SensorStats, sample.payload, sample.encoding)
    figures = {one.entity: one for one in stats.sensors}
    assert (stats.process, stats.is_active) == ("s1", True)
    assert figures["r1"].topic == "r1/scan"
    assert figures["r1"].has_subscribers
    assert figures["r1"].messages == 1
    assert not figures["r2"].has_subscribers


def test_mesh_is_fetched_in_parts_and_seen(world: SensedWorld) -> None:
    corners = np.array([[[1.0, -9.0, -9.0], [1.0, 9.0, -9.0], [1.0, 0.0, 9.0]]])
    data = write_corners(corners)
    name = sha256(data).hexdigest()
    world.assets[name] = data
    mesh = Shape("mesh", (1.0, 1.0, 1.0), mesh=name)
    world.spawn("plate", Model("plate", (Link("base", collisions=(mesh,)),), is_static=True), at(2))
    world.start("s1")
    heard = world.listen("r1/scan")

    world.step_to(24)

    assert scans_of(heard)[0][1].ranges[0] == pytest.approx(3.0)
    assert world.requests.count("get_asset") == 2


def test_missing_mesh_is_not_seen_and_asked_for_again(world: SensedWorld) -> None:
    name = "0" * 64
    world.assets[name] = b"not the file of this name"
    mesh = Shape("mesh", (1.0, 1.0, 1.0), mesh=name)
    world.spawn("plate", Model("plate", (Link("base", collisions=(mesh,)),), is_static=True), at(2))
    world.start("s1")
    heard = world.listen("r1/scan")

    world.step_to(24)
    world.step_to(48)

    assert [scan.ranges[0] for _, scan in scans_of(heard)] == pytest.approx([5.0, 5.0])
    assert world.requests.count("get_asset") == 2


def test_malformed_state_does_no_harm(world: SensedWorld) -> None:
    world.start("s1")
    heard = world.listen("r1/scan")

    world.bus.put(f"sim/{WORLD}/scene_state", b"\xff\xff")
    world.step_to(24)

    assert len(heard.take()) == 1


def test_state_with_half_a_pose_is_answered_and_not_measured(world: SensedWorld) -> None:
    world.start("s1")
    replies = world.bus.subscribe(SENSORS_REPLY.key(WORLD, "s1"), 10)
    heard = world.listen("r1/scan")
    broken = SceneState(0, 24, 24 * STEP_NS, world.roster, bytes(60), b"", ("s1",))

    world.bus.put_message(SCENE_STATE.key(WORLD), broken, Format.MSGPACK)
    world.run(0.03)
    world.step_to(48)

    assert len(replies.take()) == 2
    assert len(heard.take()) == 1


def test_counts_of_a_deleted_robot_are_forgotten_and_totals_stay(world: SensedWorld) -> None:
    process = world.start("s1")
    world.listen("*/scan")
    world.step_to(24)

    world.delete("r2")
    world.step_to(48)

    assert [name for name, *_ in process.counts.messages] == ["r1"]
    assert process.counts.total == 3


def test_scan_is_on_the_key_of_ros_2_with_the_qos_of_gazebo(world: SensedWorld) -> None:
    world.start("s1", ros=RosSettings(domain=0))
    heard = world.listen("0/r1/scan/**")

    world.step_to(24)

    (sample,) = heard.take()
    assert sample.key.startswith("0/r1/scan/sensor_msgs::msg::dds_::LaserScan_/RIHS01_64c19139")
    assert sample.attachment
    assert decode(LaserScan, sample.payload, sample.encoding).ranges[0] == pytest.approx(5.0)
    (token,) = [one for one in world.bus.list_tokens("@ros2_lv/**") if "%r1%scan" in one]
    assert "/MP/" in token
    assert "/%r1/sensors/" in token
    assert token.endswith("::,5:,:,:,,")


def test_tokens_of_a_process_go_with_it(world: SensedWorld) -> None:
    world.start("s1")
    world.listen("r1/scan")

    world.kill("s1")

    assert world.bus.list_tokens(keys.alive_sensors(WORLD, "*")) == []
    assert world.list_active() == ()
