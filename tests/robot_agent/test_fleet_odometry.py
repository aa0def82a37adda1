"""Messages with the odometry of many robots."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.codec.message_codec import Format, encode
from zensim.proto.messages.agent_messages import DriveState
from zensim.robot_agent.fleet_odometry import ROW_BYTES, MotionRows, make_messages

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
