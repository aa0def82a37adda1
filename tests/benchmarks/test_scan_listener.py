"""Waits of scans for transforms, as a message filter of tf2 has them."""

import pytest

from benchmarks.scan_listener import (
    SCAN_STAMP_AT,
    TF_STAMP_AT,
    TransformWaits,
    read_stamp_ns,
)
from zensim.proto.codec.cdr import encode
from zensim.proto.messages.standard_messages import (
    Header,
    LaserScan,
    TFMessage,
    TransformStamped,
    time_from_ns,
)

STAMP_NS = 3_000_000_005


def test_scan_waits_until_a_transform_at_or_after_its_stamp_came() -> None:
    waits = TransformWaits()
    waits.add_transform("r1", 90)
    waits.add_scan("r1", 100, 5.0)
    waits.add_scan("r2", 100, 5.0)
    first = waits.take_ended(5.0)
    waits.add_transform("r1", 100)

    assert first == []
    assert waits.take_ended(5.02) == [pytest.approx(20.0)]
    assert waits.take_ended(6.0) == []


def test_scan_after_its_transform_does_not_wait() -> None:
    waits = TransformWaits()
    waits.add_transform("r1", 120)
    waits.add_scan("r1", 100, 5.0)
    waits.add_scan("r1", 110, 5.0)

    assert waits.take_ended(5.0) == [0.0, 0.0]


def test_stamps_are_read_from_scans_and_transforms() -> None:
    header = Header(time_from_ns(STAMP_NS), "laser")
    scan, transforms = LaserScan(header), TFMessage((TransformStamped(header),))

    assert read_stamp_ns(encode(scan), SCAN_STAMP_AT) == STAMP_NS
    assert read_stamp_ns(encode(transforms), TF_STAMP_AT) == STAMP_NS
