"""Hostile payloads are decoded or refused in one line, with memory limited by their size."""

import tracemalloc
from typing import TypeAlias

import msgspec
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    decode,
    encode,
    make_encoding,
    supports_format,
)
from zensim.proto.messages.entity_messages import GetEntitiesResponse
from zensim.proto.messages.standard_messages import TFMessage
from zensim.proto.messages.telemetry_messages import GetModelsResponse, Snapshot, Stats
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.schema import list_top_level_types

Sample: TypeAlias = tuple[type[msgspec.Struct], Format, bytes]

KINDS = st.sampled_from(list_top_level_types())
SAMPLES = st.sampled_from(
    [
        (kind, format_, encode(make_sample_message(kind), format_))
        for kind in list_top_level_types()
        for format_ in Format
        if supports_format(kind, format_)
    ]
)
ENCODINGS = ["", *(format_.value for format_ in Format)]
FIRST = [b"", b"\x00\x01\x00\x00", b"\x00\x00\x00\x00", b"\x82", b"\xdf\xff\xff\xff\xff", b'{"']
MANY = settings(max_examples=settings().max_examples * 5)
LONGEST_REFUSAL = 400
MIB = 1 << 20
DEEP = 100_000


def refusal_of(kind: type[msgspec.Struct], payload: bytes, encoding: str = "") -> str:
    """Return the error of a refused payload; empty if it was decoded."""
    try:
        message = decode(kind, payload, encoding)
    except MalformedPayload as refusal:
        return str(refusal)
    assert isinstance(message, kind)
    return ""


def is_one_short_line(text: str) -> bool:
    return "\n" not in text and len(text) < LONGEST_REFUSAL


@given(
    kind=KINDS,
    first=st.sampled_from(FIRST),
    rest=st.binary(max_size=200),
    encoding=st.sampled_from(ENCODINGS),
)
@MANY
def test_decode_reads_or_refuses_random_bytes(
    kind: type[msgspec.Struct], first: bytes, rest: bytes, encoding: str
) -> None:
    refusal = refusal_of(kind, first + rest, encoding)

    assert is_one_short_line(refusal)


@given(sample=SAMPLES, data=st.data())
@MANY
def test_decode_reads_or_refuses_mutations_of_a_message(
    sample: Sample, data: st.DataObject
) -> None:
    kind, _, payload = sample
    start = data.draw(st.integers(0, len(payload)))
    end = data.draw(st.integers(start, min(len(payload), start + 8)))
    mutated = payload[:start] + data.draw(st.binary(max_size=8)) + payload[end:]

    refusal = refusal_of(kind, mutated, data.draw(st.sampled_from(ENCODINGS)))

    assert is_one_short_line(refusal)


@given(sample=SAMPLES, data=st.data())
@MANY
def test_decode_refuses_a_message_that_ends_early(sample: Sample, data: st.DataObject) -> None:
    kind, format_, payload = sample
    assume(len(payload) > 1)
    shorter = payload[: data.draw(st.integers(1, len(payload) - 1))]

    refusal = refusal_of(kind, shorter, make_encoding(kind, format_))

    assert refusal
    assert is_one_short_line(refusal)


@pytest.mark.parametrize(
    ("kind", "payload"),
    [
        (GetEntitiesResponse, b"\x81\xa8entities\xdd\xff\xff\xff\xff"),
        (GetEntitiesResponse, b"\x81\xa8entities\xdd\x0f\xff\xff\xff" + b"\xa0" * 100),
        (GetEntitiesResponse, b"\x81\xa8entities\x91\xdb\xff\xff\xff\xff"),
        (GetEntitiesResponse, b"\x81\xa7unknown\xdf\xff\xff\xff\xff"),
        (GetEntitiesResponse, b"\xdf\xff\xff\xff\xff"),
        (TFMessage, b"\x81\xaatransforms\xdd\xff\xff\xff\xff" + b"\x80" * 100),
        (Snapshot, b"\x81\xa4base\xc6\xff\xff\xff\xff"),
        (Stats, b"\x81\xa7ready_s\xdf\xff\xff\xff\xff"),
    ],
)
def test_decode_allocates_nothing_for_a_length_of_message_pack(
    kind: type[msgspec.Struct], payload: bytes
) -> None:
    tracemalloc.start()

    refusal = refusal_of(kind, payload)

    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert "truncated" in refusal
    assert peak < MIB


@pytest.mark.parametrize(
    "payload",
    [
        b'{"unknown":' + b"[" * DEEP,
        b'{"unknown":' * DEEP,
        b"\x81\xa7unknown" + b"\x91" * DEEP,
        b"\x81\xa7unknown" * DEEP,
        b'{"models":' + b"[" * DEEP,
    ],
)
def test_decode_refuses_endless_nesting(payload: bytes) -> None:
    refusal = refusal_of(GetModelsResponse, payload)

    assert refusal
    assert is_one_short_line(refusal)
