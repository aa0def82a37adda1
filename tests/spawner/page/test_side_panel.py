"""Texts of the side panel."""

import numpy as np
import pytest

from zensim.proto.messages.telemetry_messages import EntityModel, Stats
from zensim.proto.messages.vehicle_messages import VehicleStatus
from zensim.spawner.page.render_state import LastCommand, SimulationStatus
from zensim.spawner.page.side_panel import (
    AMBER,
    RED,
    format_clock,
    format_command,
    make_robot_html,
    make_status_html,
)

REST = np.array((1.0, 2.0, 0.06, 0.0, 0.0, 0.0, 1.0, 0, 0, 0, 0, 0, 0))


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.0, "0:00.00"),
        (59.994, "0:59.99"),
        (59.996, "1:00.00"),
        (61.5, "1:01.50"),
        (3661.0, "1:01:01.00"),
        (-1.0, "0:00.00"),
    ],
)
def test_clock_shows_minutes_and_hours(seconds: float, text: str) -> None:
    assert format_clock(seconds) == text


def test_status_shows_state_time_factor_and_robots() -> None:
    status = SimulationStatus("playing", 61.5, 0.987, robots=10, entities=10)

    html = make_status_html(status)

    for text in ("playing", "1:01.50", "0.99", ">10<"):
        assert text in html


@pytest.mark.parametrize(
    ("state", "reached", "wanted", "text", "is_amber"),
    [
        ("playing", 0.66, 1.0, "0.66 of 1.00", True),
        ("playing", 0.99, 1.0, "0.99 of 1.00", False),
        ("playing", 1.2, 2.0, "1.20 of 2.00", True),
        ("playing", 7.5, 0.0, "7.50", False),
        ("paused", 0.5, 1.0, "0.50 of 1.00", False),
    ],
)
def test_status_warns_of_a_real_time_factor_below_the_wanted_one(
    state: str,
    reached: float,
    wanted: float,
    text: str,
    is_amber: bool,  # noqa: FBT001  a parameter of pytest
) -> None:
    stats = Stats(target_real_time_factor=wanted)

    (line,) = make_status_html(SimulationStatus(state, 1.0, reached, stats=stats)).split(
        "Real-time factor"
    )[1:]

    value = line.partition("<dd>")[2].split("Robots")[0]
    assert text in value
    assert (AMBER in value) is is_amber


def test_robot_shows_pose_and_last_command() -> None:
    html = make_robot_html(EntityModel("r1", "team/r1", 0), REST, LastCommand(0.2, -0.5, age_s=0.1))

    for text in ("team/r1", "x 1.00  y 2.00", "v 0.20 m/s  w -0.50 rad/s"):
        assert text in html


def test_markup_in_names_is_escaped() -> None:
    html = make_robot_html(EntityModel("r1", "<img src=x>", 0), REST, None)

    assert "<img" not in html


@pytest.mark.parametrize(
    ("command", "text"),
    [
        (None, "nothing"),
        (LastCommand(0.1, 0.0, age_s=0.5), "cmd_vel  v 0.10 m/s  w 0.00 rad/s"),
        (LastCommand(0.1, 0.0, age_s=4.2), "nothing; cmd_vel  v 0.10 m/s  w 0.00 rad/s, 4 s ago"),
    ],
)
def test_old_command_is_shown_with_its_age(command: LastCommand | None, text: str) -> None:
    assert format_command(command) == text


@pytest.mark.parametrize("column", [7, 12])
def test_robot_that_moves_without_cmd_vel_is_commanded_by_an_order_or_a_client(column: int) -> None:
    state = REST.copy()
    state[column] = 0.3

    vehicle = VehicleStatus("r1", "o<7>", "driving", "n1", "n4", 81.6)

    assert "its behaviour, or a client" in make_robot_html(EntityModel("r1", "r1", 0), state, None)
    assert "order o&lt;7&gt;" in make_robot_html(EntityModel("r1", "r1", 0), state, None, vehicle)


@pytest.mark.parametrize("count", [0, 3])
def test_status_shows_malformed_messages_of_sensors_if_any(count: int) -> None:
    html = make_status_html(SimulationStatus(malformed=count))

    assert ("Malformed" in html) is bool(count)


def test_vehicle_shows_order_battery_and_errors() -> None:
    vehicle = VehicleStatus("r1", "o<7>", "waiting", "n1", "n4", 81.6, ("obstacle: <b>box</b>",))

    html = make_robot_html(EntityModel("r1", "r1", 0), REST, None, vehicle)

    for text in ("o&lt;7&gt; to n4", "waiting", "82 %", "obstacle: &lt;b&gt;box", RED):
        assert text in html


def test_vehicle_without_an_order_says_so() -> None:
    html = make_robot_html(EntityModel("r1", "r1", 0), REST, None, VehicleStatus("r1", task="idle"))

    assert "none yet" in html
    assert "Errors" not in html
