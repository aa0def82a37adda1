"""Transforms of many robots in one message are what the encoder writes, to the byte."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from zensim.proto.codec import cdr
from zensim.proto.messages.standard_messages import (
    Header,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
    time_from_ns,
)
from zensim.robot_agent.pool.joined_images import JoinedImages

NAMES = st.text(max_size=9)


def edge(names: tuple[str, str], stamp: Time, pose: list[float]) -> TransformStamped:
    transform = Transform(Vector3(*pose[:3]), Quaternion(*pose[3:]))
    return TransformStamped(Header(stamp, names[0]), names[1], transform)


@given(st.integers(1, 2), st.data())
def test_message_is_what_the_encoder_writes(count: int, data: st.DataObject) -> None:
    of_robot = st.lists(st.tuples(NAMES, NAMES), min_size=count, max_size=count)
    robots = data.draw(st.lists(of_robot, min_size=1, max_size=4))
    blank = [TFMessage(tuple(edge(one, Time(), [0.0] * 7) for one in names)) for names in robots]
    images = JoinedImages(blank)
    rows = data.draw(st.lists(st.sampled_from(range(len(robots))), unique=True, min_size=1))
    poses = np.random.default_rng(len(rows)).uniform(-9.0, 9.0, (len(rows), 7 * count))
    times_ns = [row * 10**9 + 7 for row in rows]

    written = images.message(np.array(rows), poses, np.array(times_ns))

    assert written == cdr.encode(
        TFMessage(
            tuple(
                edge(names, time_from_ns(time_ns), pose.tolist())
                for row, numbers, time_ns in zip(rows, poses, times_ns, strict=True)
                for names, pose in zip(robots[row], numbers.reshape(count, 7), strict=True)
            )
        )
    )
    assert len(written) - 8 == sum(images.size(row) for row in rows[1:]) + first_size(
        robots[rows[0]]
    )


def first_size(names: list[tuple[str, str]]) -> int:
    blank = TFMessage(tuple(edge(one, Time(), [0.0] * 7) for one in names))
    return len(cdr.encode(blank)) - 8
