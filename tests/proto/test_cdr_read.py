"""Reading bytes that are not what they should be."""

import tracemalloc
from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.proto.widest import Widest
from zensim.proto import cdr
from zensim.proto.cdr_read import MalformedPayload
from zensim.proto.example import example_of
from zensim.proto.services import GetEntitiesRequest, GetEntitiesResponse, SpawnEntityRequest
from zensim.proto.topics import JointState, String

HEADER = bytes.fromhex("00 01 00 00")
HUGE = b"\xff\xff\xff\xff"
EXAMPLE = cdr.encode(example_of(Widest))
MIB = 1 << 20


def test_decode_reads_what_encode_wrote() -> None:
    assert cdr.decode(Widest, EXAMPLE) == example_of(Widest)


@pytest.mark.parametrize("length", range(len(EXAMPLE)))
def test_decode_refuses_a_message_that_ends_early(length: int) -> None:
    with pytest.raises(MalformedPayload):
        cdr.decode(Widest, EXAMPLE[:length])


@given(place=st.integers(0, len(EXAMPLE) - 1), byte=st.integers(0, 255))
def test_decode_reads_or_refuses_when_a_byte_is_changed(place: int, byte: int) -> None:
    payload = EXAMPLE[:place] + bytes([byte]) + EXAMPLE[place + 1 :]

    with suppress(MalformedPayload):
        assert isinstance(cdr.decode(Widest, payload), Widest)


def test_decode_tolerates_an_empty_string_without_its_nul() -> None:
    assert cdr.decode(String, HEADER + bytes(4)) == String("")


@pytest.mark.parametrize(
    ("text", "wrong"),
    [
        (b"\x02\x00\x00\x00ab", "does not end with NUL"),
        (b"\x03\x00\x00\x00\xff\xfe\x00", "is not UTF-8"),
        (b"\x04\x00\x00\x00\xed\xa0\x80\x00", "is not UTF-8"),
        (HUGE, "4294967295 bytes are due at byte 8, but the payload has 8 bytes"),
    ],
)
def test_decode_refuses_a_bad_string(text: bytes, wrong: str) -> None:
    with pytest.raises(MalformedPayload, match=wrong):
        cdr.decode(String, HEADER + text)


def test_decode_refuses_a_boolean_that_is_neither_0_nor_1() -> None:
    payload = bytearray(cdr.encode(SpawnEntityRequest()))
    payload[9] = 2

    with pytest.raises(MalformedPayload, match="a boolean is 2; use 0 or 1"):
        cdr.decode(SpawnEntityRequest, bytes(payload))


@pytest.mark.parametrize(
    ("kind", "before"),
    [
        (GetEntitiesResponse, "01 00 00 00 00 00 00 00"),
        (GetEntitiesRequest, "00 00 00 00"),
        (JointState, "00 00 00 00 00 00 00 00 00 00 00 00 00 00 00 00"),
    ],
    ids=["strings", "messages", "numbers"],
)
@pytest.mark.parametrize("count", [HUGE, b"\x00\x00\x00\x10"])
def test_decode_believes_no_length_beyond_the_payload(
    kind: type[JointState], before: str, count: bytes
) -> None:
    payload = HEADER + bytes.fromhex(before) + count + bytes(100)
    tracemalloc.start()

    with pytest.raises(MalformedPayload, match="are due at byte"):
        cdr.decode(kind, payload)

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < MIB
