"""Sensor processes with real servers: rates, stamps, on demand and shares."""

import signal
from typing import Any

import pytest

from benchmarks.up_programs import find_programs
from tests.integration.processes import (
    START_S,
    Server,
    connected,
    eventually,
    free_endpoint,
    kill,
    read_json_line,
    running,
    serving,
)
from tests.integration.sensor_runs import (
    DEPTH,
    LOCKSTEP,
    ScanHasher,
    read_sensor_rows,
    read_stats,
    record_lockstep_scans,
    running_sensors,
    spawn_lidar_bots,
    wait_until_active,
)
from zensim.proto import keys
from zensim.proto.messages.simulation_messages import ResetScope
from zensim.proto.topic_catalog import SCAN
from zensim.spawner.client.sim_client import SimClient

STEP_HZ = 240
PERIOD_STEPS = 24
ROBOTS = 2
STEPS = 240


@pytest.fixture(scope="module")
def alone() -> ScanHasher:
    """The scans of a lockstep run with one sensor process."""
    return record_lockstep_scans(ROBOTS, STEPS, ["only"])


def test_lidar_publishes_each_period_with_the_time_of_its_step(alone: ScanHasher) -> None:
    step_ns = round(1e9 / STEP_HZ)
    due = [step * step_ns for step in range(PERIOD_STEPS, STEPS + 1, PERIOD_STEPS)]

    found = alone.stamps_ns["r0"]

    assert len(found) == len(due)
    assert max(abs(one - other) for one, other in zip(found, due, strict=True)) <= STEPS


@pytest.mark.long_form
def test_sixty_seconds_of_lockstep_have_six_hundred_scans() -> None:
    scans = record_lockstep_scans(1, 60 * STEP_HZ, ["only"])

    assert abs(scans.count - 600) <= 1


def test_nothing_is_sent_while_nobody_listens_and_scans_come_soon_after() -> None:
    with serving("--world", "warehouse") as server, running_sensors(server, "s1"):
        spawn_lidar_bots(server, 2)
        pattern = keys.active_sensors("default", "*")
        was_active = bool(server.bus.list_tokens(pattern))

        scans = server.bus.subscribe(SCAN.key("r1"), DEPTH)
        eventually(lambda: bool(scans.take()), START_S, "a scan")
        scans.close()
        eventually(lambda: not server.bus.list_tokens(pattern), START_S, "the end of the stream")

    assert not was_active


def test_scans_continue_when_one_of_two_processes_is_killed() -> None:
    with serving("--world", "warehouse") as server, running_sensors(server, "s1", "s2") as (one, _):
        names = spawn_lidar_bots(server, 4)
        scans = ScanHasher(server.bus.subscribe(SCAN.key("*"), DEPTH))
        wait_until_active(server, "s1", "s2")
        eventually(lambda: _heard(scans, names, since_ns=0), START_S, "scans of all")

        kill(one.pid, signal.SIGKILL)
        wait_until_active(server, "s2")
        killed_ns = round(server.client.info().sim_time_s * 1e9)
        eventually(lambda: _heard(scans, names, since_ns=killed_ns), START_S, "scans of all again")


def test_sensors_are_listed_with_rate_subscribers_and_cost() -> None:
    with serving("--world", "warehouse") as server, running_sensors(server, "s1"):
        spawn_lidar_bots(server, 2)
        scans = ScanHasher(server.bus.subscribe(SCAN.key("r1"), DEPTH))
        eventually(lambda: _heard(scans, ["r1"], since_ns=0), START_S, "a scan")
        eventually(lambda: read_stats(server).sensor_messages > 0, START_S, "counts")
        eventually(lambda: list_by_robot(server)["r1"]["has_subscribers"], START_S, "subscribers")

        rows = list_by_robot(server)

    assert rows["r1"]["topics"] == ["r1/scan"]
    assert rows["r1"]["rate_hz"] == 10.0
    assert rows["r1"]["published"] > 0
    assert rows["r1"]["cost_s"] > 0.0
    assert rows["r1"]["process"] == "s1"


def test_reset_begins_a_new_epoch_of_scans() -> None:
    with serving(*LOCKSTEP) as server, running_sensors(server, "s1"):
        spawn_lidar_bots(server, 1)
        scans = ScanHasher(server.bus.subscribe(SCAN.key("*"), DEPTH))
        wait_until_active(server, "s1")
        server.client.simulate_steps(2 * PERIOD_STEPS)
        server.client.reset(ResetScope.TIME | ResetScope.STATE)
        server.client.simulate_steps(2 * PERIOD_STEPS)
        eventually(lambda: _has_heard(scans, 4), START_S, "scans")

    stamps = scans.stamps_ns["r0"]
    assert len(stamps) == 4
    assert stamps[:2] == stamps[2:]


def test_up_starts_a_sensor_process_with_the_first_robot_that_needs_one() -> None:
    endpoint = free_endpoint()
    with running("up", "--robots", "1", "--no-viewer", "--json", "--listen", endpoint) as up:
        read_json_line(up)
        assert find_programs(up)["sensors"] == ()
        with connected(endpoint, up) as bus:
            server = Server(up, endpoint, bus, SimClient(bus, timeout_s=START_S))

            spawn_lidar_bots(server, 1)

            scans = bus.subscribe(SCAN.key("r0"), DEPTH)
            eventually(lambda: bool(scans.take()), START_S, "a scan")


def _heard(scans: ScanHasher, names: list[str], *, since_ns: int) -> bool:
    scans.take()
    return all(scans.stamps_ns.get(name, [-1])[-1] > since_ns for name in names)


def _has_heard(scans: ScanHasher, count: int) -> bool:
    scans.take()
    return scans.count >= count


def list_by_robot(server: Server) -> dict[str, dict[str, Any]]:
    return {row["entity"]: row for row in read_sensor_rows(server)}
