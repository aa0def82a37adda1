"""Numbers that plots show."""

import csv
import io

import msgspec
import numpy as np
import pytest

from zensim.proto.messages.agent_messages import STATE_COLUMNS
from zensim.proto.messages.standard_messages import Imu, JointState, LaserScan, Range, Vector3
from zensim.spawner.page.plot_history import (
    MAX_FIELDS,
    MAX_NAME,
    PLOT_POINTS,
    PlotHistory,
    find_axis_range,
    format_number,
    measure_robot,
    name_robot_columns,
    read_numbers,
)
from zensim.spawner.page.render_state import LastCommand


def test_history_keeps_the_last_minute() -> None:
    history = PlotHistory()

    for step in range(PLOT_POINTS + 10):
        assert history.add(step * 0.2, {"a": step, "b": 2.0 * step})

    times, values = history.make_arrays(["b"])
    assert len(times) == PLOT_POINTS
    assert times[0] == pytest.approx(2.0)
    assert values[-1] == 2.0 * (PLOT_POINTS + 9)


def test_history_adds_nothing_while_time_stands() -> None:
    history = PlotHistory()
    history.add(1.0, {"a": 1.0})

    assert not history.add(1.0, {"a": 1.0})
    assert len(history.make_arrays(["a"])[0]) == 1


def test_history_keeps_the_columns_that_stay_when_others_come_and_go() -> None:
    history = PlotHistory()
    history.add(1.0, {"a": 1.0, "b": 2.0})
    history.add(2.0, {"b": 3.0, "c": 4.0})
    assert history.columns == ("b", "c")

    times, b, c = history.make_arrays(["b", "c"])
    assert (times.tolist(), b.tolist()) == ([1.0, 2.0], [2.0, 3.0])
    assert np.isnan(c).tolist() == [True, False]
    assert history.make_csv().decode().splitlines()[1:] == ["1,2,", "2,3,4"]
    assert find_axis_range([b, c], has_zero=False) == find_axis_range([b, c[1:]], has_zero=False)


def test_history_begins_anew_after_a_reset() -> None:
    history = PlotHistory()
    history.add(2.0, {"b": 2.0})

    history.add(0.5, {"b": 3.0})
    assert history.make_arrays(["b"])[0].tolist() == [0.5]


def test_rows_that_are_not_finite_are_not_plotted() -> None:
    history = PlotHistory()
    for step, value in enumerate((1.0, float("inf"), float("nan"), 4.0)):
        history.add(float(step), {"a": value})

    assert [array.tolist() for array in history.make_arrays(["a"])] == [[0.0, 3.0], [1.0, 4.0]]
    assert history.make_csv().decode().splitlines()[:2] == ["simulation time [s],a", "0,1"]


def test_names_in_csv_are_quoted_so_that_readers_find_them_again() -> None:
    history, name = PlotHistory(), 'joint "a", left\nwheel'
    history.add(0.0, {name: 1.5, "b": 2.0})

    rows = list(csv.reader(io.StringIO(history.make_csv().decode(), newline="")))

    assert rows == [["simulation time [s]", name, "b"], ["0", "1.5", "2"]]


def test_empty_history_has_empty_arrays() -> None:
    assert [len(array) for array in PlotHistory().make_arrays([])] == [0]


def test_columns_of_a_robot_are_speed_turn_rate_and_position() -> None:
    state = np.zeros(STATE_COLUMNS)
    state[:2], state[7:9], state[12] = (1.0, 2.0), (0.3, 0.4), -0.5

    values = measure_robot("r1", state, LastCommand(0.6, 0.7, age_s=0.0))

    assert list(values.values()) == pytest.approx([0.5, 0.6, -0.5, 0.7, 1.0, 2.0])
    assert [*values] == [one for pair in name_robot_columns("r1").values() for one in pair]
    assert "r1 v commanded [m/s]" not in measure_robot("r1", state, None)
    old = measure_robot("r1", state, LastCommand(0.6, 0.7, age_s=1.5))
    assert (old["r1 v commanded [m/s]"], old["r1 w commanded [rad/s]"]) == (0.0, 0.0)


@pytest.mark.parametrize(
    ("message", "numbers"),
    [
        (
            LaserScan(range_min=0.1, range_max=9.0, ranges=(0.01, 3.0, 2.0, float("inf"))),
            {"nearest [m]": 2.0},
        ),
        (LaserScan(range_min=0.1, range_max=9.0), {"nearest [m]": float("inf")}),
        (LaserScan(range_max=9.0, ranges=(float("nan"), -1.0, 3.0)), {"nearest [m]": 3.0}),
        (JointState(name=("a", "b"), position=(0.1, 0.2)), {"a": 0.1, "b": 0.2}),
        (JointState(name=("a" * 999,), position=(0.1,)), {"a" * MAX_NAME: 0.1}),
        (JointState(name=("j",), position=()), {}),
    ],
)
def test_numbers_of_a_message(message: msgspec.Struct, numbers: dict[str, float]) -> None:
    assert read_numbers(message) == numbers


def test_numbers_of_a_message_are_its_first_fields_without_covariances() -> None:
    numbers = read_numbers(Imu(angular_velocity=Vector3(z=0.5)))

    assert len(numbers) == MAX_FIELDS
    assert not any("covariance" in name or "header" in name for name in numbers)
    assert read_numbers(Range(range=1.5))["range"] == 1.5


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ([], (0.0, 0.1)),
        ([0.0, 0.0], (0.0, 0.1)),
        ([0.2, 0.2], (0.0, 0.25)),
        ([0.1999, 0.2], (0.0, 0.25)),
        ([-0.5, 0.2], (-0.6, 0.3)),
        ([-0.4], (-0.45, 0.0)),
        ([101325.0], (0.0, 150000.0)),
        ([1e-300], (0.0, 0.1)),
        ([-1e308, 1e308], (-1e308, 1e308)),
    ],
)
def test_axis_has_zero_and_room_beyond_the_values(
    values: list[float], wanted: tuple[float, float]
) -> None:
    assert find_axis_range([np.array(values)], has_zero=True) == pytest.approx(wanted)


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ([101315.0, 101335.0], (101310.0, 101340.0)),
        ([-101335.0, -101315.0], (-101340.0, -101310.0)),
        ([101325.0], (101315.0, 101335.0)),
        ([1.0, 2.0], (0.0, 2.5)),
        ([-1.0, 100.0], (-50.0, 150.0)),
        ([], (0.0, 0.1)),
    ],
)
def test_axis_has_zero_only_beside_values_that_are_as_far_from_it(
    values: list[float], wanted: tuple[float, float]
) -> None:
    assert find_axis_range([np.array(values)], has_zero=False) == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    ("number", "text"),
    [(0.0, "0.00"), (0.3, "0.30"), (101325.123, "101325.12"), (4.9e-5, "4.90e-05")],
)
def test_legend_has_small_and_large_numbers(number: float, text: str) -> None:
    assert format_number(number) == text


def test_axis_stays_while_values_change_little() -> None:
    found = {
        find_axis_range([np.array([0.2, 0.2 + 0.0001 * i])], has_zero=True) for i in range(100)
    }

    assert len(found) == 1
