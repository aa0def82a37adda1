"""Messages that are filled in have the bytes of messages that are encoded whole."""

import msgspec
import numpy as np
import pytest

from zensim.proto.codec import cdr
from zensim.proto.messages.standard_messages import (
    Header,
    LaserScan,
    PointCloud2,
    PointField,
    Range,
    time_from_ns,
)
from zensim.sim_server.sensors.array_messages import ArrayMessages, split_rows

FRAMES = ("a", "a_much/longer_frame", "bc")
TIME_NS = 3_000_000_007
ALL = np.arange(3)


def in_frames(template: msgspec.Struct) -> list[msgspec.Struct]:
    return [msgspec.structs.replace(template, header=Header(frame_id=one)) for one in FRAMES]


def stamped(frame: str) -> Header:
    return Header(time_from_ns(TIME_NS), frame)


def test_numbers_of_an_array_and_the_stamp_are_filled_in() -> None:
    template = LaserScan(angle_max=1.0, range_max=9.0)
    messages = ArrayMessages(in_frames(template), array="ranges", item=(0.0,))
    ranges = np.arange(12.0).reshape(3, 4)

    messages.fill(ALL, TIME_NS, lengths=4)
    written = messages.write(ALL, split_rows(ranges.astype("<f4")))

    assert written == [
        cdr.encode(
            msgspec.structs.replace(template, header=stamped(frame), ranges=tuple(row.tolist()))
        )
        for frame, row in zip(FRAMES, ranges, strict=True)
    ]


def test_what_follows_the_array_stays() -> None:
    template = LaserScan(intensities=(0.0, 7.0))
    messages = ArrayMessages(in_frames(template), array="ranges", item=(0.0,))

    messages.fill(ALL[1:2], TIME_NS, lengths=2)
    (written,) = messages.write(ALL[1:2], [np.array([1.0, 2.0], "<f4").tobytes()])

    assert cdr.decode(LaserScan, written) == msgspec.structs.replace(
        template, header=stamped(FRAMES[1]), ranges=(1.0, 2.0)
    )


@pytest.mark.parametrize("sizes", [(16, 16, 16), (0, 32, 16)])
def test_bytes_of_different_lengths_are_filled_in(sizes: tuple[int, ...]) -> None:
    template = PointCloud2(height=1, fields=(PointField("x", 0, 7, 1),), is_dense=True)
    messages = ArrayMessages(
        in_frames(template), array="data", item=b"\1", integers=("width", "row_step")
    )
    arrays = [bytes(range(size)) for size in sizes]
    counts = np.array(sizes) // 16

    messages.fill(
        ALL, TIME_NS, lengths=np.array(sizes), integers=np.stack([counts, np.array(sizes)], axis=1)
    )
    written = messages.write(ALL, arrays)

    assert written == [
        cdr.encode(
            msgspec.structs.replace(
                template,
                header=stamped(frame),
                width=len(data) // 16,
                row_step=len(data),
                data=data,
            )
        )
        for frame, data in zip(FRAMES, arrays, strict=True)
    ]


def test_a_number_without_an_array_is_filled_in() -> None:
    template = Range(max_range=4.0)
    messages = ArrayMessages(in_frames(template), numbers=("range",))

    messages.fill(ALL[:2], TIME_NS, numbers=np.array([[1.5], [np.inf]]))
    written = messages.write(ALL[:2], [b"", b""])

    assert written == [
        cdr.encode(msgspec.structs.replace(template, header=stamped(frame), range=value))
        for frame, value in zip(FRAMES, (1.5, np.inf), strict=False)
    ]
