"""The newest odometry of each robot from the messages of several agents."""

from typing import Final

import numpy as np
import pytest

from tests.fakes import ManualClock, MemoryBus
from zensim.api.odometry_table import MAX_KNOWN_NAMES, OLD_EPOCH_S, TABLE_DEPTH, OdometryTable
from zensim.proto.codec.message_codec import Format
from zensim.proto.messages.agent_messages import FleetOdometry
from zensim.proto.topic_catalog import FLEET_ODOMETRY
from zensim.spawner.client.topic_reader import read_topic

KEY: Final = FLEET_ODOMETRY.key("default", "pool")


class Feed:
    """Odometry of an agent on a network in memory."""

    def __init__(self) -> None:
        self.bus = MemoryBus()
        self.reader = read_topic(self.bus, KEY, FleetOdometry, TABLE_DEPTH)

    def put(self, *messages: FleetOdometry) -> None:
        """Publish messages."""
        for message in messages:
            self.bus.put_message(KEY, message, Format.MSGPACK)


def a_message(second: int, *entities: str, epoch: int = 0) -> FleetOdometry:
    motions = np.full((len(entities), 13), float(second)) + np.arange(len(entities))[:, None]
    return FleetOdometry(epoch, second, second * 10**9, entities, motions.astype("<f8").tobytes())


def test_each_robot_has_its_newest_row() -> None:
    feed = Feed()
    table = OdometryTable(feed.reader)
    feed.put(a_message(1, "a", "b"), a_message(2, "c"), a_message(3, "b"))

    rows = table.read(["b", "a", "nobody", "c", "b"])

    assert rows.times == pytest.approx([3.0, 1.0, np.nan, 2.0, 3.0], nan_ok=True)
    assert rows.poses[:, 0] == pytest.approx([3.0, 1.0, np.nan, 2.0, 3.0], nan_ok=True)
    assert (rows.poses.shape, rows.twists.shape) == ((5, 7), (5, 6))


def test_robots_of_a_former_epoch_are_gone() -> None:
    feed = Feed()
    table = OdometryTable(feed.reader)
    feed.put(a_message(5, "a", "b"))
    table.read([])
    feed.put(a_message(1, "b", epoch=1))

    assert table.read(["a", "b"]).times == pytest.approx([np.nan, 1.0], nan_ok=True)


def test_late_message_of_a_former_epoch_is_left_out() -> None:
    feed, clock = Feed(), ManualClock(50.0)
    table = OdometryTable(feed.reader, clock)
    feed.put(
        a_message(5, "a", "b"),
        a_message(1, "a", epoch=1),
        a_message(6, "b"),
        a_message(2, "b", epoch=1),
    )

    assert table.read(["a", "b"]).times.tolist() == [1.0, 2.0]


def test_new_server_begins_with_a_lower_epoch() -> None:
    feed, clock = Feed(), ManualClock(50.0)
    table = OdometryTable(feed.reader, clock)
    feed.put(a_message(5, "a", epoch=3))
    table.read([])

    clock.sleep(OLD_EPOCH_S)
    feed.put(a_message(1, "b"))

    assert table.read(["a", "b"]).times == pytest.approx([np.nan, 1.0], nan_ok=True)


def test_rows_are_kept_while_robots_come() -> None:
    feed = Feed()
    table = OdometryTable(feed.reader)
    names = [f"r{number}" for number in range(40)]
    for second, name in enumerate(names, 1):
        feed.put(a_message(second, name))
        table.read([])

    assert table.read(names).times.tolist() == list(range(1, 41))


def test_message_whose_arrays_do_not_fit_is_left_out() -> None:
    feed = Feed()
    table = OdometryTable(feed.reader)
    feed.put(FleetOdometry(0, 1, 1, ("a", "b"), b"\0" * 104))

    assert np.isnan(table.read(["a"]).times).all()
    table.close()
    assert not feed.bus.has_subscriber(KEY)


def test_names_that_are_read_again_are_found_when_robots_came_or_time_began_again() -> None:
    feed = Feed()
    table = OdometryTable(feed.reader)
    times = []
    for message in (a_message(1, "a"), a_message(2, "b"), a_message(3, "b", "a", epoch=1)):
        feed.put(message)
        times.append(table.read(["a", "b"]).times.tolist())

    assert times == [pytest.approx([1.0, np.nan], nan_ok=True), [1.0, 2.0], [3.0, 3.0]]


def test_equal_names_of_another_epoch_have_the_rows_of_that_epoch() -> None:
    feed = Feed()
    table = OdometryTable(feed.reader)
    feed.put(a_message(1, "a"), a_message(2, "b", "c"))
    table.read([])
    feed.put(a_message(3, "b", "c", epoch=1), a_message(4, "a", epoch=1))

    rows = table.read(["a", "b", "c"])

    assert rows.times.tolist() == [4.0, 3.0, 3.0]
    assert rows.poses[:, 0].tolist() == [4.0, 3.0, 4.0]


def test_rows_stay_when_messages_have_ever_other_names() -> None:
    feed = Feed()
    table = OdometryTable(feed.reader)
    names = [f"robot{number}" for number in range(MAX_KNOWN_NAMES)]
    feed.put(
        *(a_message(1 + number, *names[number : number + 2]) for number in range(len(names))),
        a_message(1000, *names[:2]),
        a_message(2000, *reversed(names[:2])),
    )

    rows = table.read(names)

    assert rows.times[:4].tolist() == [2000.0, 2000.0, 3.0, 4.0]
    assert rows.poses[:2, 0].tolist() == [2001.0, 2000.0]
