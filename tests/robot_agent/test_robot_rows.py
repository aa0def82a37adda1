"""Rows of robots: rate limiters open as single ones do, selections are those of numpy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from zensim.proto.rate_limiter import RateLimiter
from zensim.robot_agent.robot_rows import (
    GroupRateLimiter,
    IntArray,
    KeptRows,
    find_index,
    intersect_rows,
    make_row_places,
    remap_floats,
    take_rows,
)

RATES = [0.0, 7.0, 30.0, 50.0, 80.0, 100.0]
STEPS = st.lists(st.sampled_from([0, 4_166_667, 12_500_000, 10_000_000, 1]), max_size=60)


@pytest.mark.parametrize("rate_hz", RATES)
@settings(max_examples=25)
@given(st.lists(STEPS, min_size=1, max_size=4))
def test_rows_open_as_single_rate_limiters_do(rate_hz: float, courses: list[list[int]]) -> None:
    limiters, singles, time_ns = GroupRateLimiter(rate_hz), [], 0
    # Each course begins with a robot more.
    for course in courses:
        singles.append(RateLimiter(rate_hz))
        limiters.remap(np.array([*range(len(singles) - 1), -1], dtype=np.int64))
        for step_ns in course:
            time_ns += step_ns
            expected = {
                row: elapsed_s
                for row, single in enumerate(singles)
                if (elapsed_s := single.elapsed_s(time_ns)) is not None
            }
            rows, elapsed = limiters.open(time_ns)
            assert dict(zip(rows.tolist(), elapsed.tolist(), strict=True)) == expected


def test_rows_forget_openings_at_a_reset() -> None:
    limiters = GroupRateLimiter(10.0)
    limiters.remap(np.array([-1, -1], dtype=np.int64))
    limiters.open(10**9)

    limiters.reset()

    assert limiters.open(0)[0].tolist() == [0, 1]


def test_rows_keep_their_openings_when_remapped() -> None:
    limiters = GroupRateLimiter(10.0)
    limiters.remap(np.array([-1], dtype=np.int64))
    limiters.open(0)
    limiters.remap(np.array([-1, 0], dtype=np.int64))

    assert limiters.open(50_000_000)[0].tolist() == [0]
    assert limiters.open(100_000_000)[0].tolist() == [1]


def test_openings_are_put_back_as_they_were_saved() -> None:
    limiters = GroupRateLimiter(10.0)
    limiters.remap(np.array([-1, -1], dtype=np.int64))
    limiters.open(0)
    saved = limiters.save()
    limiters.open(100_000_000)
    limiters.reset(np.array([1]))
    limiters.load(saved)

    assert limiters.open(50_000_000)[0].tolist() == []
    rows, elapsed_s = limiters.open(100_000_000)
    assert (rows.tolist(), elapsed_s.tolist()) == ([0, 1], [0.1, 0.1])


@given(st.lists(st.tuples(st.sets(st.integers(0, 3)), st.booleans()), max_size=8))
def test_rows_are_kept_as_of_their_own_time(courses: list[tuple[set[int], bool]]) -> None:
    kept, expected = KeptRows(2), np.zeros((4, 2))
    kept.remap(np.full(4, -1))
    for number, (some, is_remapped) in enumerate(courses):
        columns = np.full((4, 2), float(number))
        columns.flags.writeable = False
        rows = np.array(sorted(some), dtype=np.int64)
        expected[rows] = columns[rows]
        kept.keep(rows, columns)
        if is_remapped:
            kept.remap(np.array([1, 0, 3, 2]))
            expected = expected[[1, 0, 3, 2]]
        assert kept.values.tolist() == expected.tolist()


def test_rows_that_stay_keep_their_values_and_new_ones_are_zero() -> None:
    column, before = np.array([[1.0, 2.0], [3.0, 4.0]]), np.array([1, -1, 0], dtype=np.int64)

    assert remap_floats(column, before).tolist() == [[3.0, 4.0], [0.0, 0.0], [1.0, 2.0]]
    assert remap_floats(column, before, 7.0)[1].tolist() == [7.0, 7.0]


ROWS = st.sets(st.integers(0, 7)).map(lambda found: np.array(sorted(found), dtype=np.int64))


@given(ROWS)
def test_rows_that_are_taken_and_put_are_those_of_numpy(rows: IntArray) -> None:
    column = np.arange(16.0).reshape(8, 2)
    expected = column.copy()
    expected[rows] = column[rows] + 100.0

    column[find_index(rows, len(column))] = take_rows(column, rows) + 100.0

    assert column.tolist() == expected.tolist()


@given(ROWS, ROWS)
def test_rows_of_both_are_found(rows: IntArray, others: IntArray) -> None:
    found = intersect_rows(rows, others, 8)

    assert found.tolist() == sorted({*rows.tolist()} & {*others.tolist()})


@pytest.mark.parametrize("places", [[2, 3, 4], [4, 2, 3], [2, 4, 5]])
def test_numbers_are_read_and_written_where_they_are(places: list[int]) -> None:
    found, array = make_row_places(np.array(places)), np.arange(10.0)

    read = found.read(array).tolist()
    found.write(array, np.array([0.1, 0.2, 0.3]))

    assert read == [float(place) for place in places]
    assert array[places].tolist() == [0.1, 0.2, 0.3]


def test_numbers_of_rows_are_read_by_row() -> None:
    places = make_row_places(np.array([[2, 3], [4, 5]]))
    matrix = np.arange(20.0).reshape(10, 2)

    assert places.read(np.arange(10.0)).tolist() == [[2.0, 3.0], [4.0, 5.0]]
    assert make_row_places(np.array([1, 2])).read(matrix).tolist() == [[2.0, 3.0], [4.0, 5.0]]


def test_no_places_read_nothing() -> None:
    assert make_row_places(np.zeros((0, 2), dtype=np.int64)).read(np.arange(4.0)).shape == (0, 2)
