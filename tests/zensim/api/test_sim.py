"""The API on a server: real processes on an ephemeral port."""

import asyncio
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import pytest

import zensim
from tests.integration.processes import START_S, eventually
from zensim.api.step_channel import StepChannel
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.simulation_messages import SimulateStepsRequest
from zensim.proto.service_catalog import SIMULATE_STEPS

STEPPER = """
import sys, zensim
sim = zensim.connect(sys.argv[1], timeout_s=120.0)
sim.spawn("box_bot", name="own", bond=True, x=3.0)
robot = sim.robots["r1"]
robot.drive(0.3, 0.0)
for number, now in enumerate(sim.steps(seconds=1e6)):
    if number == 20:
        print("steps", flush=True)
"""


def test_ordered_robot_moves_as_it_was_told(sim: zensim.Sim) -> None:
    robot = sim.spawn("box_bot", name="r1", yaw=0.5)

    robot.drive(0.2, 0.5)
    sim.run_for(2.0)

    assert robot.twist.v == pytest.approx(0.2, abs=0.01)
    assert robot.pose.yaw == pytest.approx(1.46, abs=0.05)
    assert robot.odom.twist.twist.linear.x == pytest.approx(0.2, abs=0.01)
    assert sim.time == pytest.approx(2.0, abs=1e-6)


def test_order_holds_longer_than_cmd_vel_and_ends_with_stop(sim: zensim.Sim) -> None:
    robot = sim.spawn("box_bot", name="r1")

    robot.drive(0.2)
    sim.run_for(3.0)
    assert robot.pose.x == pytest.approx(0.6, abs=0.05)
    robot.stop()
    sim.run_for(1.0)

    assert robot.twist.speed < 1e-3


def test_order_acts_in_the_next_control_step(sim: zensim.Sim) -> None:
    robot = sim.spawn("box_bot", name="r1")
    for _ in sim.steps(seconds=0.2):
        robot.drive(0.0)
    before = robot.pose.x

    for number, _ in enumerate(sim.steps(seconds=5 * sim.control_period)):
        if number == 0:
            robot.drive(0.5)
        elif number == 1:
            # The wheels have begun to turn; the body tips before it rolls.
            assert max(map(abs, robot.twist)) > 0.01

    assert robot.pose.x > before


def test_formation_gives_equal_hashes(sim: zensim.Sim) -> None:
    assert run_formation(sim) == run_formation(sim)


def run_formation(sim: zensim.Sim) -> str:
    sim.reset()
    offsets = np.array([[0.0, 0.0], [-1.0, 1.0], [-1.0, -1.0]])
    fleet = sim.spawn_fleet("box_bot", poses=offsets)
    for now in sim.steps(seconds=2, rate=20):
        x, y, yaw = fleet.poses2d().T
        dx, dy = x[0] + offsets[:, 0] - x, y[0] + offsets[:, 1] - y
        fleet.drive(v=np.hypot(dx, dy).clip(0, 0.5), w=2 * np.sin(np.arctan2(dy, dx) - yaw))
        fleet[0].drive(0.2, 0.1 * np.sin(now))
    return sim.state_hash()


def test_fleet_has_a_row_for_each_robot(sim: zensim.Sim) -> None:
    fleet = sim.spawn_fleet("box_bot", count=4, layout="row", spacing=2.0)

    fleet.drive(v=np.array([0.0, 0.1, 0.2, 0.3]))
    sim.run_for(1.0)
    fleet[1].delete()

    assert fleet.alive.tolist() == [True, False, True, True]
    assert np.isnan(fleet.poses()[1]).all()
    assert (fleet.poses()[:, 0] - [0.0, 2.0, 4.0, 6.0])[[0, 2, 3]] == pytest.approx(
        [0.0, 0.2, 0.3], abs=0.05
    )
    assert not fleet.poses().flags.writeable
    assert fleet[fleet.alive].names == ("box_bot0", "box_bot2", "box_bot3")


def test_handle_of_a_deleted_robot_says_so(sim: zensim.Sim) -> None:
    robot = sim.spawn("box_bot", name="r1")
    robot.delete()

    assert not robot.exists
    for use in (lambda: robot.pose, lambda: robot.twist, lambda: robot.drive(0.1)):
        with pytest.raises(zensim.NotFound) as caught:
            use()
        assert caught.value.slug == "entity_gone"


def test_unknown_robot_is_not_found_with_near_names(sim: zensim.Sim) -> None:
    sim.spawn("box_bot", name="cart1")

    with pytest.raises(zensim.NotFound) as caught:
        sim.robots["cart2"]

    assert "cart1" in caught.value.hint


@pytest.mark.parametrize("v", [math.nan, math.inf, [0.1, 0.2]])
def test_wrong_twist_is_invalid_and_nothing_is_sent(sim: zensim.Sim, v: object) -> None:
    fleet = sim.spawn_fleet("box_bot", count=3)

    with pytest.raises(zensim.Invalid):
        fleet.drive(v=v)  # type: ignore[arg-type]
    sim.run_for(0.5)

    assert np.abs(fleet.twists()[:, 0]).max() < 1e-3


def test_follow_drives_to_the_last_point(sim: zensim.Sim) -> None:
    robot = sim.spawn("box_bot", name="r1")

    robot.follow([(0.5, 0.0), (1.0, 0.5)], speed=0.4)
    sim.wait_until(lambda: robot.pose.distance_to(1.0, 0.5) < 0.1, within=15.0)

    assert sim.time < 10.0


def test_wait_until_ends_with_a_timeout(sim: zensim.Sim) -> None:
    with pytest.raises(zensim.Timeout):
        sim.wait_until(lambda: False, within=0.1)

    assert sim.time == pytest.approx(0.1, abs=0.02)


def test_callback_runs_in_the_thread_that_steps(sim: zensim.Sim) -> None:
    robot = sim.spawn("box_bot", name="r1")
    stamps = []

    @robot.on("odom", queue=100)
    def note(odom: object) -> None:
        stamps.append(odom)

    sim.run_for(1.0)
    count = len(stamps)
    note.cancel()
    sim.run_for(0.5)

    assert count >= 9
    assert len(stamps) == count


def test_exception_of_a_callback_reaches_the_caller_once(sim: zensim.Sim) -> None:
    robot = sim.spawn("box_bot", name="r1")

    @robot.on("odom")
    def fail(_: object) -> None:
        raise LookupError("of the callback")

    with pytest.raises(LookupError):
        sim.run_for(1.0)
    sim.run_for(0.5)


def test_second_client_cannot_step(sim: zensim.Sim) -> None:
    sim.step()

    with (
        zensim.connect(sim.endpoint, timeout_s=120.0) as other,
        pytest.raises(zensim.SteppedElsewhere) as caught,
    ):
        other.step()

    assert caught.value.slug == "stepped_elsewhere"


def test_check_reports_without_spawning(sim: zensim.Sim) -> None:
    report = sim.check("box_bot")

    assert report.drive == "diff_drive"
    assert not report.warnings
    assert not sim.robots


def test_missing_model_is_not_found(sim: zensim.Sim) -> None:
    with pytest.raises(zensim.NotFound):
        sim.check("no/such/file.urdf")


def test_simulation_and_handles_cannot_be_pickled(sim: zensim.Sim) -> None:
    robot = sim.spawn("box_bot", name="r1")

    for one in (sim, robot, sim.spawn_fleet("box_bot", count=1, prefix="f", spacing=3.0)):
        with pytest.raises(zensim.Error) as caught:
            pickle.dumps(one)
        assert caught.value.slug == "not_picklable"


def test_kill_of_a_stepping_script_returns_the_world_to_its_mode() -> None:
    with zensim.launch(rtf=1, timeout_s=120.0) as own:
        robot = own.spawn("box_bot", name="r1")
        script = subprocess.Popen(
            [sys.executable, "-c", STEPPER, own.endpoint], stdout=subprocess.PIPE
        )
        try:
            assert script.stdout is not None
            assert script.stdout.readline() == b"steps\n"
            eventually(lambda: own.is_paused, 2.0)
            assert "own" in own.entities
            killed_s = time.monotonic()
            os.kill(script.pid, signal.SIGKILL)
            eventually(lambda: not own.is_paused, 2.5)
            eventually(lambda: "own" not in own.entities, 2.5)
            eventually(lambda: robot.twist.speed < 0.01, 2.5)
            assert time.monotonic() - killed_s < 10.0
        finally:
            script.kill()
            script.wait()
            assert script.stdout is not None
            script.stdout.close()
        with open_bus(BusConfig(connect=(own.endpoint,))) as bus:
            assert bus.list_tokens(keys.alive_clients("default")) == []


def test_no_server_is_unreachable_with_its_endpoint() -> None:
    began_s = time.monotonic()

    with pytest.raises(zensim.Unreachable) as caught:
        zensim.connect("tcp/127.0.0.1:9", timeout_s=0.5)

    assert "127.0.0.1:9" in caught.value.message
    assert time.monotonic() - began_s < 5.0


def test_closed_simulation_refuses(sim: zensim.Sim) -> None:
    with zensim.connect(sim.endpoint, timeout_s=120.0) as other:
        other.close()
        for use in (lambda: other.time, other.pause, lambda: other.run_for(1.0)):
            with pytest.raises(zensim.Error) as caught:
                use()
            assert caught.value.slug == "closed"


def test_attached_controller_drives_all_its_robots(sim: zensim.Sim) -> None:
    fleet = sim.spawn_fleet("box_bot", count=3, layout="row", spacing=2.0)
    periods = []

    def control(robots: zensim.Fleet, period: float) -> np.ndarray:
        periods.append(period)
        return np.column_stack([0.3 - 0.1 * np.arange(len(robots)), np.zeros(len(robots))])

    end = sim.attach(fleet, control)
    sim.run_for(2.0)
    end()
    sim.run_for(1.0)

    assert periods[0] == pytest.approx(sim.control_period)
    assert np.abs(fleet.twists()).max() < 1e-2
    moved = fleet.poses()[:, 0] - [0.0, 2.0, 4.0]
    assert moved == pytest.approx([0.6, 0.4, 0.2], abs=0.08)


def test_temporary_robots_are_gone_after_the_block(sim: zensim.Sim) -> None:
    sim.spawn("box_bot", name="kept")

    with sim.temporary():
        sim.spawn("box_bot", name="gone", x=2.0)

    assert list(sim.robots) == ["kept"]


def test_fleet_is_written_with_all_its_names_or_an_ellipsis(sim: zensim.Sim) -> None:
    fleet = sim.spawn_fleet("box_bot", count=4, prefix="r")

    assert repr(fleet) == "Fleet(4 robots: r0, r1, r2, …)"
    assert repr(fleet[[True, True, True, False]]) == "Fleet(3 robots: r0, r1, r2)"
    assert repr(fleet[[False] * 4]) == "Fleet(0 robots: none)"


def test_notebooks_get_short_tables(sim: zensim.Sim) -> None:
    fleet = sim.spawn_fleet("box_bot", count=20)

    for one in (sim, fleet, sim.check("box_bot")):
        assert 0 < len(one._repr_html_()) < 20_000


def test_servers_lists_the_server(sim: zensim.Sim) -> None:
    (found,) = zensim.servers(sim.endpoint)

    assert (found.world, found.info.world) == ("default", "default")


def test_it_works_in_a_running_event_loop(sim: zensim.Sim) -> None:
    async def use() -> float:
        sim.run_for(0.1)
        return sim.time

    assert asyncio.run(use()) == pytest.approx(0.1, abs=0.01)


def test_load_replaces_the_world_and_stays_paused(sim: zensim.Sim) -> None:
    sim.load("walls")
    try:
        assert sim.is_paused
        assert sim.info.world_model == "walls"
        assert "walls" in " ".join(sim.worlds())
        assert "box_bot" in sim.models()
        ranges, names = sim.cast_rays([[0.0, 0.0, 0.2]], [[1.0, 0.0, 0.0]], range_max=50.0)
        assert np.isfinite(ranges).all()
        assert names[0]
    finally:
        sim.load("empty")


def test_async_iteration_gives_messages_while_another_thread_steps(sim: zensim.Sim) -> None:
    odom = sim.spawn("box_bot", name="r1").topic("odom")
    odom.collect()

    async def read_three() -> list[float]:
        stamps: list[float] = []
        stepping = asyncio.create_task(asyncio.to_thread(sim.run_for, 1.0))
        async for message in odom:
            stamps.append(message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec)
            if len(stamps) == 3:
                break
        await stepping
        return stamps

    stamps = asyncio.run(read_three())

    # An agent that is late leaves states out: the messages are whole periods apart.
    periods = np.diff(stamps) / 0.0125
    assert (periods > 0.5).all()
    assert periods == pytest.approx(periods.round(), abs=1e-3)
    assert stamps == sorted(set(stamps))


def test_lost_request_of_steps_is_repeated_and_counts_once() -> None:
    with zensim.launch(timeout_s=120.0) as own, open_bus(BusConfig(connect=(own.endpoint,))) as bus:
        name = "client_of_a_test"
        token = bus.token(keys.alive_client("default", name))
        request = SimulateStepsRequest(3, client=name, wants_snapshot=True)
        eventually(lambda: is_accepted(bus, request), 10.0)
        lost = StepChannel(bus, "elsewhere", name)
        channel = StepChannel(bus, "default", name)

        assert lost.call(request, timeout_s=0.2) is None
        first = channel.call(request, timeout_s=60.0)
        again = bus.call(
            SIMULATE_STEPS, request, world="default", request_id=channel.request_id, timeout_s=60.0
        )

        assert first is not None
        assert first.snapshot is not None
        assert first.snapshot.step == 6
        assert again == first
        token.close()


def is_accepted(bus: Bus, request: SimulateStepsRequest) -> bool:
    """Request steps, which are refused until the server has the token."""
    try:
        bus.call(SIMULATE_STEPS, request, world="default", timeout_s=60.0)
    except ServiceError:
        return False
    return True


def test_recording_is_read_by_topic_and_as_a_table(sim: zensim.Sim, tmp_path: Path) -> None:
    robot = sim.spawn("box_bot", name="taped", x=7.0, y=7.0)
    recorder = sim.record(tmp_path / "run.mcap", "taped/*", timeout_s=90.0)
    robot.drive(0.2)
    sim.run_for(1.0)
    recording = recorder.read()

    last = list(recording.messages("taped/odom"))[-1]
    table = recording.table("*/odom")
    assert recording.is_closed
    assert recording.topics["/taped/odom"] == "nav_msgs/msg/Odometry"
    assert set(table["robot"].tolist()) == {"taped"}
    assert len(table["t_ns"]) == recording.counts["/taped/odom"]
    assert table["pose.pose.position.x"][-1] == last.data.pose.pose.position.x  # type: ignore[attr-defined]
    assert last.time == pytest.approx(recording.end, abs=0.5)
    with pytest.raises(zensim.Error, match="exists"):
        sim.record(tmp_path / "run.mcap", timeout_s=90.0)


def test_page_of_the_world_is_served_until_it_is_closed(sim: zensim.Sim) -> None:
    page = sim.show(timeout_s=90.0)
    try:
        with urllib.request.urlopen(page.url, timeout=120.0) as reply:
            assert reply.status == 200
        assert page.url in page._repr_html_()
    finally:
        page.close()
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(page.url, timeout=5.0)


def follow_in_lockstep(
    endpoint: str, is_there: threading.Event, seen: list[tuple[float, float]]
) -> None:
    """Drive r1 from 1 s to 2 s, as a client that has joined."""
    with zensim.connect(endpoint, timeout_s=START_S) as other:
        robot = other.robots["r1"]
        is_there.set()
        with other.join_lockstep(rate=20) as steps:
            for now in steps:
                seen.append((now, robot.pose.x))
                if now >= 1.0:
                    robot.drive(0.3, 0.2)
                if now >= 2.0:
                    break


def run_with_a_joined_client(sim: zensim.Sim) -> tuple[str, list[tuple[float, float]]]:
    sim.reset()
    sim.spawn("box_bot", name="r1")
    seen: list[tuple[float, float]] = []
    is_there = threading.Event()
    client = threading.Thread(target=follow_in_lockstep, args=(sim.endpoint, is_there, seen))
    client.start()
    assert is_there.wait(START_S)
    while not seen and sim.time < 1.0:
        sim.step()
    sim.run_to(2.5)
    client.join(START_S)
    return sim.state_hash(), [one for one in seen if one[0] >= 1.0]


def test_client_that_has_joined_is_awaited_and_gives_the_same_run_each_time(
    sim: zensim.Sim,
) -> None:
    first, seen = run_with_a_joined_client(sim)
    second, again = run_with_a_joined_client(sim)

    assert first == second
    assert seen == again
    assert [now for now, _ in seen] == pytest.approx(np.arange(1.0, 2.01, 0.05))
    assert seen[-1][1] > 0.2


def test_client_that_has_joined_makes_no_steps_itself(sim: zensim.Sim) -> None:
    with sim.join_lockstep() as steps:
        with pytest.raises(zensim.Invalid) as refused:
            sim.run_for(0.1)
        assert sim.is_paused
    sim.run_for(0.1)

    assert refused.value.slug == "joined"
    assert next(steps, None) is None
