"""Messages with the odometry of many robots."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes import MemoryBus
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.agent_messages import DriveState, FleetOdometry
from zensim.proto.topic_catalog import FLEET_ODOMETRY
from zensim.robot_agent.fleet_odometry import (
    MAX_SENT_AT_ONCE,
    ROW_BYTES,
    FleetOdometryPublisher,
    MotionRows,
    make_messages,
)

BATCH_BYTES = 1 << 16
STATE = DriveState(2, 7, 70_000_000, b"", b"", b"", b"")
names = st.text("abc_0", min_size=1, max_size=64)


def make_rows(parts: list[list[str]]) -> list[MotionRows]:
    numbers = iter(range(10**9))
    return [
        MotionRows(
            part,
            np.array([[next(numbers)] * 13 for _ in part], dtype="<f8").tobytes(),
            np.array([[next(numbers)] * joints for _ in part], dtype="<f8").tobytes(),
        )
        for joints, part in enumerate(parts)
    ]


@given(parts=st.lists(st.lists(names, max_size=4), max_size=4), repeats=st.sampled_from([1, 9, 90]))
def test_messages_have_all_rows_in_order_and_fit_a_batch(
    parts: list[list[str]], repeats: int
) -> None:
    rows = make_rows(parts * repeats)

    made = list(make_messages(STATE, rows))

    assert [name for one in made for name in one.entities] == [
        name for part in rows for name in part.entities
    ]
    assert b"".join(one.motions for one in made) == b"".join(part.motions for part in rows)
    assert b"".join(one.joint_positions for one in made) == b"".join(
        part.joint_positions for part in rows
    )
    assert all(len(one.motions) == ROW_BYTES * len(one.entities) > 0 for one in made)
    assert all(len(encode(one, Format.MSGPACK)) < BATCH_BYTES for one in made)
    assert {(one.epoch, one.step, one.time_ns) for one in made} <= {(2, 7, 70_000_000)}


def test_five_thousand_robots_take_few_messages() -> None:
    rows = make_rows([[f"box_bot{number}" for number in range(5000)]])

    assert len(list(make_messages(STATE, rows))) <= 11


def test_messages_have_robots_of_one_kind_of_rate() -> None:
    alike, own = make_rows([["a"], ["b", "c"]])

    made = list(make_messages(STATE, [alike, own._replace(has_own_tf_rate=True), alike]))

    assert [(one.entities, one.has_own_tf_rate) for one in made] == [
        (("a",), False),
        (("b", "c"), True),
        (("a",), False),
    ]


class PublishedOdometry:
    """Odometry of 5000 robots, and the messages that have come."""

    def __init__(self) -> None:
        bus = MemoryBus()
        self.rows = make_rows([[f"box_bot{number}" for number in range(5000)]])
        self.whole = list(make_messages(STATE, self.rows))
        self.publisher = FleetOdometryPublisher(bus, "default", "a")
        self._received = bus.subscribe(FLEET_ODOMETRY.key("default", "a"), 100)

    def take(self) -> list[FleetOdometry]:
        """Take what has come."""
        taken = self._received.take()
        return [decode(FleetOdometry, one.payload, one.encoding) for one in taken]


def test_messages_of_a_state_are_sent_in_parts_and_in_order() -> None:
    odometry = PublishedOdometry()

    odometry.publisher.begin(STATE, iter(odometry.rows))
    first = odometry.take()
    odometry.publisher.send_some()
    second = odometry.take()
    odometry.publisher.send_some()

    assert [first, second] == [odometry.whole[:MAX_SENT_AT_ONCE], odometry.whole[MAX_SENT_AT_ONCE:]]
    assert len(first) == MAX_SENT_AT_ONCE > len(second) > 0
    assert odometry.take() == []


def test_unsent_messages_of_a_state_come_before_those_of_the_next_and_before_the_end() -> None:
    odometry, next_state = PublishedOdometry(), DriveState(2, 8, 80_000_000, b"", b"", b"", b"")

    odometry.publisher.begin(STATE, odometry.rows)
    odometry.publisher.begin(next_state, odometry.rows)
    steps = [one.step for one in odometry.take()]
    odometry.publisher.close()

    whole = len(odometry.whole)
    assert steps == [7] * whole + [8] * MAX_SENT_AT_ONCE
    assert [one.step for one in odometry.take()] == [8] * (whole - MAX_SENT_AT_ONCE)


def test_awaited_odometry_is_sent_at_once() -> None:
    odometry = PublishedOdometry()

    odometry.publisher.publish(STATE, odometry.rows)

    assert odometry.take() == odometry.whole
