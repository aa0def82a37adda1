import pytest
import zenoh.ext
from zenoh_ros2_sdk.attachment import Attachment as TheirAttachment

from zensim.proto.ros2.rmw_attachment import Attachment, read_attachment, write_attachment

GID = bytes(range(16))
ATTACHMENT = Attachment(258, -2, GID)
RAW = bytes.fromhex("0201000000000000 feffffffffffffff 10 000102030405060708090a0b0c0d0e0f")


def test_attachment_has_its_33_bytes() -> None:
    assert write_attachment(ATTACHMENT) == RAW
    assert read_attachment(RAW) == ATTACHMENT


def test_attachment_is_what_zenohs_own_serializer_writes() -> None:
    theirs = zenoh.ext.z_serialize((zenoh.ext.Int64(258), zenoh.ext.Int64(-2), GID))

    assert theirs.to_bytes() == RAW


def test_attachment_is_read_by_another_implementation() -> None:
    theirs = TheirAttachment.from_bytes(write_attachment(Attachment(1, 2, GID)))

    assert (theirs.sequence_id, theirs.timestamp_ns, theirs.gid) == (1, 2, GID)


@pytest.mark.parametrize("raw", [b"", RAW[:-1], RAW + b"\0", RAW.replace(b"\x10", b"\x0f")])
def test_attachment_is_nothing_when_bytes_are_wrong(raw: bytes) -> None:
    assert read_attachment(raw) is None
