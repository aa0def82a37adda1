"""Messages filled in place have the bytes of the encoder."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.robot_agent.models import DRIVE, two_wheeler
from zensim.proto.codec import cdr
from zensim.proto.messages.standard_messages import (
    Header,
    JointState,
    Quaternion,
    TFMessage,
    Transform,
    TransformStamped,
    Vector3,
    time_from_ns,
)
from zensim.robot_agent import message_templates
from zensim.robot_agent.odometry import BaseMotion, OdometryHeader, make_covariance
from zensim.robot_agent.pool.group_topic import CdrBatch

NUMBER = st.floats(allow_nan=False, allow_infinity=False)
TIME_NS = st.integers(0, 2**31 * 10**9 - 1)


def motion_of(numbers: list[float]) -> BaseMotion:
    x, y, z, qx, qy, qz, qw, vx, vy, wz = numbers
    return BaseMotion((x, y, z), (qx, qy, qz, qw), vx, vy, wz)


@given(
    st.lists(st.tuples(st.text(max_size=9), st.text(max_size=9)), min_size=1, max_size=4),
    st.data(),
)
def test_odometry_is_what_the_encoder_writes(
    names: list[tuple[str, str]], data: st.DataObject
) -> None:
    frames = [OdometryHeader(frame, child, make_covariance(DRIVE)) for frame, child in names]
    blank = [one.message(BaseMotion(), time_from_ns(0)) for one in frames]
    batch = CdrBatch(blank, message_templates.ODOMETRY_PATHS, message_templates.HEADER_STAMP)
    rows = data.draw(st.lists(st.sampled_from(range(len(names))), unique=True, min_size=1))
    numbers = [data.draw(st.lists(NUMBER, min_size=10, max_size=10)) for _ in rows]
    times = [data.draw(TIME_NS) for _ in rows]

    batch.fill(np.array(rows), np.array(numbers), np.array(times))

    written = [
        cdr.encode(frames[row].message(motion_of(one), time_from_ns(time)))
        for row, one, time in zip(rows, numbers, times, strict=True)
    ]
    assert batch.payloads(np.array(rows)) == [
        written[rows.index(row)] for row in (sorted(rows) if len(rows) == len(names) else rows)
    ]
    assert [batch.payload(row) for row in rows] == written


@pytest.mark.parametrize("child", ["", "a", "ab", "abc", "abcd", "abcde", "abcdef", "abcdefg"])
def test_transforms_are_what_the_encoder_writes(child: str) -> None:
    def message(numbers: list[float], time_ns: int) -> TFMessage:
        stamp = time_from_ns(time_ns)
        parts = [numbers[:7], numbers[7:]]
        return TFMessage(
            tuple(
                TransformStamped(
                    Header(stamp, "odom"),
                    child * number,
                    Transform(Vector3(*part[:3]), Quaternion(*part[3:])),
                )
                for number, part in enumerate(parts)
            )
        )

    numbers = np.arange(14.0).tolist()
    batch = CdrBatch(
        [message([0.0] * 14, 0)],
        message_templates.list_tf_paths(2),
        message_templates.list_tf_stamps(2),
    )

    batch.fill(np.array([0]), np.array([numbers]), np.array([3 * 10**9 + 5]))

    assert batch.payload(0) == cdr.encode(message(numbers, 3 * 10**9 + 5))


def test_joint_states_are_what_the_encoder_writes() -> None:
    model = two_wheeler()
    batch = CdrBatch(
        [message_templates.make_joint_states_template(model, (0, 1))],
        message_templates.list_joint_paths(2),
        message_templates.HEADER_STAMP,
    )

    batch.fill(np.array([0]), np.array([[0.1, 0.2, 0.3, 0.4]]), np.array([10**9]))

    expected = JointState(
        Header(time_from_ns(10**9)), ("left_joint", "right_joint"), (0.1, 0.2), (0.3, 0.4)
    )
    assert batch.payload(0) == cdr.encode(expected)
