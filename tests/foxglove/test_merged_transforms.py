"""Transforms that are merged and prefixed without decoding equal those that are decoded."""

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.foxglove.merged_transforms import (
    STAMP_BYTES,
    collect_transforms,
    join_transforms,
    make_transform,
    prefix_frames,
)
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.standard_messages import (
    Header,
    Quaternion,
    TFMessage,
    Time,
    Transform,
    TransformStamped,
    Vector3,
)

NUMBERS = st.floats(-10.0, 10.0)
FRAMES = st.text("abc_/é", max_size=9)


@st.composite
def make_messages(draw: st.DrawFn) -> TFMessage:
    transforms = draw(
        st.lists(
            st.builds(
                TransformStamped,
                st.builds(Header, st.builds(Time, st.integers(0, 99)), FRAMES),
                FRAMES,
                st.builds(Transform, st.builds(Vector3, NUMBERS, NUMBERS, NUMBERS)),
            ),
            max_size=4,
        )
    )
    return TFMessage(tuple(transforms))


@given(st.lists(make_messages(), max_size=4))
def test_merged_message_has_all_transforms_in_order(messages: list[TFMessage]) -> None:
    payloads = [encode(one, Format.CDR) for one in messages]

    merged = decode(TFMessage, join_transforms(collect_transforms(payloads)))

    assert merged.transforms == tuple(one for message in messages for one in message.transforms)


@given(make_messages())
def test_frames_are_prefixed_once(message: TFMessage) -> None:
    found = collect_transforms([encode(message, Format.CDR)])

    prefixed = [
        (names[:STAMP_BYTES] + prefix_frames(names[STAMP_BYTES:], b"abc/"), numbers)
        for names, numbers in found
    ]

    decoded = decode(TFMessage, join_transforms(prefixed)).transforms
    for before, after in zip(message.transforms, decoded, strict=True):
        for old, new in (
            (before.header.frame_id, after.header.frame_id),
            (before.child_frame_id, after.child_frame_id),
        ):
            assert new == (old if old.startswith("abc/") else f"abc/{old}")
        assert after.transform == before.transform
        assert after.header.stamp == before.header.stamp


def test_made_transform_is_decoded() -> None:
    made = make_transform("world", "r1/odom", (1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0))

    (found,) = decode(TFMessage, join_transforms([made])).transforms

    assert found == TransformStamped(
        Header(Time(), "world"),
        "r1/odom",
        Transform(Vector3(1.0, 2.0, 3.0), Quaternion(0.0, 0.0, 0.0, 1.0)),
    )


@pytest.mark.parametrize("cut", [0, 3, 7, 9, 30, 60])
def test_message_that_ends_too_early_is_left_out(cut: int) -> None:
    whole = encode(TFMessage((TransformStamped(child_frame_id="a"),) * 2), Format.CDR)

    found = collect_transforms([whole[:cut], whole])

    assert len(found) == 2


def test_big_endian_message_is_converted() -> None:
    stamped = TransformStamped(child_frame_id="a", transform=Transform(Vector3(1.0)))
    little = encode(TFMessage((stamped,)), Format.CDR)
    # One transform without a frame_id: the same fields in the other byte order.
    big = bytearray(b"\0\0\0\0")
    big += (1).to_bytes(4, "big") + bytes(8) + (1).to_bytes(4, "big") + b"\0\0\0\0"
    big += (2).to_bytes(4, "big") + b"a\0"
    big += bytes(-(len(big) - 4) % 8)
    big += struct.pack(">7d", 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)

    assert collect_transforms([bytes(big)]) == collect_transforms([little])
