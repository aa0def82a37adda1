"""Rows of processes and robots."""

import pytest
from msgspec.structs import replace

from tests.spawner.top.readings import a_reading, a_usage
from zensim.proto.messages.process_messages import AgentStats
from zensim.proto.messages.sensing_messages import SensorStats
from zensim.proto.messages.telemetry_messages import AgentCommands
from zensim.spawner.top.fleet_figures import (
    FleetReading,
    filter_rows,
    format_value,
    list_process_rows,
    list_robot_rows,
    sort_rows,
    write_summary,
)
from zensim.spawner.top.local_processes import LocalProcess


def test_processes_have_shares_and_rates_since_the_reading_before() -> None:
    server, agent = list_process_rows(a_reading(12), a_reading(10))

    assert (server.kind, server.cpu, server.memory_mib, server.rate_hz) == (
        *("server", 0.5, 64.0, 240.0),
    )
    assert (agent.name, agent.robots, agent.cpu, agent.rate_hz) == ("pool", 2, 0.5, 100.0)


def test_agent_has_the_rate_of_the_states_it_got() -> None:
    reading = a_reading(12)
    assert reading.stats is not None
    commands = {"pool": AgentCommands(taken=100, due=200, taken_hz=50.0, due_hz=100.0)}
    now = replace(reading, stats=replace(reading.stats, agent_commands=commands))

    assert [row.due_hz for row in list_process_rows(now, None)] == [None, 100.0]
    assert [row.due_hz for row in list_process_rows(reading, None)] == [None, None]


def test_first_reading_has_no_shares() -> None:
    rows = list_process_rows(a_reading(10), None)

    assert [(row.cpu, row.rate_hz) for row in rows] == [(None, None), (None, None)]


def test_process_that_was_started_anew_has_no_share_yet() -> None:
    again = replace(a_usage(12), process_id=8)
    now = replace(a_reading(12), agents={"pool": AgentStats("pool", usage=again)})

    assert list_process_rows(now, a_reading(10))[1].cpu is None


def test_rate_is_not_negative_after_a_reset() -> None:
    stats = a_reading(12).stats
    assert stats is not None
    now = replace(a_reading(12), stats=replace(stats, steps=3))

    assert list_process_rows(now, a_reading(10))[0].rate_hz == 0.0


def test_sensor_processes_and_children_are_listed() -> None:
    before = FleetReading(read_s=1.0, children=(LocalProcess(9, 7, "worker", 1.0, 1 << 20),))
    now = FleetReading(
        read_s=3.0,
        children=(LocalProcess(9, 7, "worker", 1.5, 2 << 20),),
        sensors={"sensors_1": SensorStats("sensors_1", messages=3, usage=a_usage(2))},
    )

    sensors, child = list_process_rows(now, before)

    assert (sensors.kind, sensors.name, sensors.process_id) == ("sensors", "sensors_1", 7)
    assert (child.kind, child.name, child.cpu, child.memory_mib) == ("child", "worker", 0.25, 2.0)


def test_child_that_reports_itself_is_listed_once() -> None:
    now = replace(a_reading(12), children=(LocalProcess(7, 1, "agent", 1.0, 1),))

    assert len(list_process_rows(now, None)) == 2


def test_robots_have_poses_speeds_and_measured_rates() -> None:
    first, second = list_robot_rows(a_reading(1))

    assert (first.name, first.x, first.y, first.speed, first.odom_hz) == (
        *("r1", 1.0, 2.0, 5.0, 50.0),
    )
    assert (second.name, second.drive, second.agent, second.odom_hz) == (
        *("team/r2", "omni_drive", "pool", None),
    )


def test_robots_have_no_poses_without_a_snapshot() -> None:
    row = list_robot_rows(replace(a_reading(1), snapshot=None))[0]

    assert (row.x, row.speed) == (None, None)


@pytest.mark.parametrize(
    ("column", "is_descending", "names"),
    [
        ("name", False, ["r1", "team/r2"]),
        ("name", True, ["team/r2", "r1"]),
        ("x", False, ["team/r2", "r1"]),
        ("odom_hz", False, ["r1", "team/r2"]),
        ("odom_hz", True, ["r1", "team/r2"]),
    ],
)
def test_rows_are_sorted_with_unknown_values_last(
    *, column: str, is_descending: bool, names: list[str]
) -> None:
    rows = sort_rows(list_robot_rows(a_reading(1)), column, is_descending=is_descending)

    assert [row.name for row in rows] == names


@pytest.mark.parametrize(
    ("text", "names"),
    [("", ["r1", "team/r2"]), ("TEAM", ["team/r2"]), ("diff", ["r1"]), ("nobody", [])],
)
def test_filter_is_part_of_any_word_of_a_row(text: str, names: list[str]) -> None:
    rows = filter_rows(list_robot_rows(a_reading(1)), text)

    assert [row.name for row in rows] == names


@pytest.mark.parametrize(
    ("column", "value", "text"),
    [
        ("cpu", 0.125, "12.5 %"),
        ("speed", 0.5, "0.50"),
        ("rate_hz", None, "-"),
        ("x", float("nan"), "nan"),
        ("process_id", 12, "12"),
        ("name", "r1", "r1"),
    ],
)
def test_values_are_written_with_the_digits_of_their_column(
    column: str, value: object, text: str
) -> None:
    assert format_value(column, value) == text


def test_summary_has_the_factor_that_is_reached_and_wanted() -> None:
    assert "0.98 of 1" in write_summary(a_reading(3))
    assert "2 robots" in write_summary(a_reading(3))
    assert write_summary(a_reading(3, is_stale=True)) != write_summary(a_reading(3))
    assert write_summary(FleetReading())
