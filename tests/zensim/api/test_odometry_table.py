"""The newest odometry of each robot from the messages of several agents."""

import numpy as np
import pytest

from tests.fakes import ManualClock
from zensim.api.odometry_table import MAX_KNOWN_NAMES, OLD_EPOCH_S, OdometryTable
from zensim.api.world_access import TopicFeed
from zensim.proto.messages.agent_messages import FleetOdometry


class ListedFeed(TopicFeed[FleetOdometry]):
    """Messages of a list."""

    def __init__(self) -> None:
        self.messages: list[FleetOdometry] = []
        self.is_closed = False

    def take(self, *, newest_only: bool = False) -> list[FleetOdometry]:
        del newest_only
        taken, self.messages = self.messages, []
        return taken

    def close(self) -> None:
        self.is_closed = True


def a_message(second: int, *entities: str, epoch: int = 0) -> FleetOdometry:
    motions = np.full((len(entities), 13), float(second)) + np.arange(len(entities))[:, None]
    return FleetOdometry(epoch, second, second * 10**9, entities, motions.astype("<f8").tobytes())


def test_each_robot_has_its_newest_row() -> None:
    feed = ListedFeed()
    table = OdometryTable(feed)
    feed.messages = [a_message(1, "a", "b"), a_message(2, "c"), a_message(3, "b")]

    rows = table.read(["b", "a", "nobody", "c", "b"])

    assert rows.times == pytest.approx([3.0, 1.0, np.nan, 2.0, 3.0], nan_ok=True)
    assert rows.poses[:, 0] == pytest.approx([3.0, 1.0, np.nan, 2.0, 3.0], nan_ok=True)
    assert (rows.poses.shape, rows.twists.shape) == ((5, 7), (5, 6))


def test_robots_of_a_former_epoch_are_gone() -> None:
    feed = ListedFeed()
    table = OdometryTable(feed)
    feed.messages = [a_message(5, "a", "b")]
    table.read([])
    feed.messages = [a_message(1, "b", epoch=1)]

    assert table.read(["a", "b"]).times == pytest.approx([np.nan, 1.0], nan_ok=True)


def test_late_message_of_a_former_epoch_is_left_out() -> None:
    feed, clock = ListedFeed(), ManualClock(50.0)
    table = OdometryTable(feed, clock)
    feed.messages = [
        a_message(5, "a", "b"),
        a_message(1, "a", epoch=1),
        a_message(6, "b"),
        a_message(2, "b", epoch=1),
    ]

    assert table.read(["a", "b"]).times.tolist() == [1.0, 2.0]


def test_new_server_begins_with_a_lower_epoch() -> None:
    feed, clock = ListedFeed(), ManualClock(50.0)
    table = OdometryTable(feed, clock)
    feed.messages = [a_message(5, "a", epoch=3)]
    table.read([])

    clock.sleep(OLD_EPOCH_S)
    feed.messages = [a_message(1, "b")]

    assert table.read(["a", "b"]).times == pytest.approx([np.nan, 1.0], nan_ok=True)


def test_rows_are_kept_while_robots_come() -> None:
    feed = ListedFeed()
    table = OdometryTable(feed)
    names = [f"r{number}" for number in range(40)]
    for second, name in enumerate(names, 1):
        feed.messages = [a_message(second, name)]
        table.read([])

    assert table.read(names).times.tolist() == list(range(1, 41))


def test_message_whose_arrays_do_not_fit_is_left_out() -> None:
    feed = ListedFeed()
    table = OdometryTable(feed)
    feed.messages = [FleetOdometry(0, 1, 1, ("a", "b"), b"\0" * 104)]

    assert np.isnan(table.read(["a"]).times).all()
    table.close()
    assert feed.is_closed


def test_names_that_are_read_again_are_found_when_robots_came_or_time_began_again() -> None:
    feed = ListedFeed()
    table = OdometryTable(feed)
    times = []
    for message in (a_message(1, "a"), a_message(2, "b"), a_message(3, "b", "a", epoch=1)):
        feed.messages = [message]
        times.append(table.read(["a", "b"]).times.tolist())

    assert times == [
        pytest.approx([1.0, np.nan], nan_ok=True),
        [1.0, 2.0],
        [3.0, 3.0],
    ]


def test_equal_names_of_another_epoch_have_the_rows_of_that_epoch() -> None:
    feed = ListedFeed()
    table = OdometryTable(feed)
    feed.messages = [a_message(1, "a"), a_message(2, "b", "c")]
    table.read([])
    feed.messages = [a_message(3, "b", "c", epoch=1), a_message(4, "a", epoch=1)]

    rows = table.read(["a", "b", "c"])

    assert rows.times.tolist() == [4.0, 3.0, 3.0]
    assert rows.poses[:, 0].tolist() == [4.0, 3.0, 4.0]


def test_rows_stay_when_messages_have_ever_other_names() -> None:
    feed = ListedFeed()
    table = OdometryTable(feed)
    names = [f"robot{number}" for number in range(MAX_KNOWN_NAMES)]
    feed.messages = [
        *(a_message(1 + number, *names[number : number + 2]) for number in range(len(names))),
        a_message(1000, *names[:2]),
        a_message(2000, *reversed(names[:2])),
    ]

    rows = table.read(names)

    assert rows.times[:4].tolist() == [2000.0, 2000.0, 3.0, 4.0]
    assert rows.poses[:2, 0].tolist() == [2001.0, 2000.0]
