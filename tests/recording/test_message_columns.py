"""Columns hold what the codec decodes, for every type and every layout."""

import struct
from operator import attrgetter
from typing import Any

import msgspec
import numpy as np
import pytest

from zensim.proto.codec.cdr_layout import Leaf
from zensim.proto.codec.message_codec import Format, decode, encode
from zensim.proto.messages.standard_messages import (
    Header,
    JointState,
    LaserScan,
    Odometry,
    TFMessage,
    Time,
    TransformStamped,
)
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.schema import list_cdr_types
from zensim.recording import message_columns
from zensim.recording.message_columns import (
    Column,
    ColumnDecoder,
    MessageColumns,
    TextColumn,
    join_columns,
)


def decode_all(
    kind: type[msgspec.Struct], payloads: list[bytes], *, wants_arrays: bool = False
) -> list[MessageColumns]:
    return list(ColumnDecoder(kind, wants_arrays=wants_arrays).decode(payloads))


def read(column: Column, row: int) -> object:
    return column.to_list()[row] if isinstance(column, TextColumn) else column[row].tolist()


def find_value(message: object, path: str) -> Any:  # noqa: ANN401
    """Find the value at a path such as `name[1]` or `a.b`."""
    for part in path.replace("[", ".[").split("."):
        if part.startswith("["):
            message = list(message)[int(part[1:-1])]  # type: ignore[call-overload]
        else:
            message = attrgetter(part)(message)
    return list(message) if isinstance(message, tuple | bytes) else message


@pytest.mark.parametrize("kind", list_cdr_types().values(), ids=list_cdr_types())
def test_columns_of_each_type_equal_the_decoded_message(kind: type[msgspec.Struct]) -> None:
    payload = encode(make_sample_message(kind), Format.CDR)
    message = decode(kind, payload, "")

    groups = decode_all(kind, [payload, payload], wants_arrays=True)

    assert groups
    for number, group in enumerate(groups):
        assert group.messages.tolist() == [0, 1]
        for path, column in group.columns.items():
            whole = (
                path
                if len(groups) == 1
                else f"{msgspec.structs.fields(kind)[0].name}[{number}].{path}"
            )
            assert read(column, 1) == find_value(message, whole), path


def test_messages_of_several_layouts_keep_their_rows() -> None:
    frames = ["a/odom", "bb/odom", "odom/a", "a/odom"]
    # The third has the size of the first, and another layout.
    bases = ["base", "base", "base", "base"]
    bases[2] = "b"
    frames[2] = "odom/a_bc"[:9]
    messages = [
        Odometry(Header(Time(number, 5), frame), base)
        for number, (frame, base) in enumerate(zip(frames, bases, strict=True))
    ]

    groups = decode_all(Odometry, [encode(one, Format.CDR) for one in messages])

    found = {
        int(number): (
            read(group.columns["header.stamp.sec"], row),
            read(group.columns["header.frame_id"], row),
        )
        for group in groups
        for row, number in enumerate(group.messages)
    }
    assert found == {number: (number, frame) for number, frame in enumerate(frames)}


def test_transforms_have_a_row_each() -> None:
    message = TFMessage(tuple(TransformStamped(child_frame_id=name) for name in ("x", "yy")))

    groups = decode_all(TFMessage, [encode(message, Format.CDR), encode(TFMessage(), Format.CDR)])

    assert [read(group.columns["child_frame_id"], 0) for group in groups] == ["x", "yy"]


def test_long_sequences_are_columns_on_request_only() -> None:
    payload = encode(LaserScan(ranges=tuple(map(float, range(90)))), Format.CDR)

    (plain,) = decode_all(LaserScan, [payload])
    (whole,) = decode_all(LaserScan, [payload], wants_arrays=True)

    assert "ranges" not in plain.columns
    assert read(whole.columns["ranges"], 0) == list(map(float, range(90)))


def test_cut_messages_and_those_of_other_byte_order_are_told_apart() -> None:
    payload = encode(Odometry(Header(Time(7, 8), "odom"), "base"), Format.CDR)
    swapped = b"\0\0\0\0" + struct.pack(">iI", 7, 8) + struct.pack(">I", 1 << 31)
    decoder = ColumnDecoder(Odometry)

    groups = list(decoder.decode([payload[:20], swapped, payload, b"\0"]))

    assert [group.messages.tolist() for group in groups] == [[2]]
    assert decoder.damaged == 3


def test_joined_columns_fill_what_a_group_does_not_have() -> None:
    groups: list[dict[str, Column]] = [
        {"t": np.array([1, 2]), "name[0]": TextColumn(np.array([0, 0], np.int32), ("left",))},
        {"t": np.array([3]), "position[0]": np.array([0.5]), "ranges": np.ones((1, 3))},
    ]
    names = join_columns(groups, "name[0]", "t")
    positions = join_columns(groups, "position[0]", "t")

    assert isinstance(names, TextColumn)
    assert names.to_list() == ["left", "left", ""]
    assert np.isnan(positions[:2]).all()  # type: ignore[index]
    assert (
        join_columns([*groups, {"t": np.array([4]), "ranges": np.ones((1, 4))}], "ranges", "t")
        is None
    )


def test_joints_are_columns() -> None:
    message = JointState(name=("left", "right"), position=(0.25, 0.5))

    (group,) = decode_all(JointState, [encode(message, Format.CDR)])

    assert read(group.columns["name[1]"], 0) == "right"
    assert read(group.columns["position[1]"], 0) == 0.5


@pytest.mark.parametrize("size", [20, 200])
def test_damaged_messages_of_one_layout_are_left_out_at_once(
    monkeypatch: pytest.MonkeyPatch, size: int
) -> None:
    reads: list[object] = []
    find_leaves = message_columns.find_leaves

    def count(kind: type[msgspec.Struct]) -> tuple[Leaf, ...]:
        reads.append(kind)
        return find_leaves(kind)

    monkeypatch.setattr(message_columns, "find_leaves", count)
    whole = encode(Odometry(Header(Time(7, 8), "odom"), "base"), Format.CDR)
    decoder = ColumnDecoder(Odometry)

    groups = list(decoder.decode([bytes(size)] * 3000 + [whole]))

    assert [group.messages.tolist() for group in groups] == [[3000]]
    assert decoder.damaged == 3000
    assert len(reads) < 10


def test_many_layouts_of_one_size_are_decoded_one_by_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(message_columns, "MAX_LAYOUTS", 3)
    payloads = [
        encode(JointState(Header(), ("a" * number, "b" * (40 - number))), Format.CDR)
        for number in range(1, 40)
    ]
    payloads.insert(20, payloads[0][:-8] + b"\xff" * 8)

    groups = decode_all(JointState, payloads)

    found = {int(row): read(one.columns["name[0]"], 0) for one in groups for row in one.messages}
    assert all(
        decode(JointState, payloads[row], Format.CDR.value).name[0] == text
        for row, text in found.items()
    )
    assert set(found) == set(range(len(payloads))) - {20}
