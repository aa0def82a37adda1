"""The committed golden bytes are read as the examples that they were written from."""

import json
from typing import TypeAlias

import msgspec
import pytest

from zensim.proto.codec import Format, decode, encode, encoding_of, offers
from zensim.proto.example import example_of
from zensim.proto.schema import SCHEMAS, golden, spoken_types

Golden: TypeAlias = dict[str, dict[str, str]]

COMMITTED: Golden = json.loads((SCHEMAS / "golden.json").read_text(encoding="utf-8"))
SAMPLES = [
    pytest.param(kind, format_, id=f"{kind.__name__} in {format_.name}")
    for kind in spoken_types()
    for format_ in Format
    if format_.name in COMMITTED.get(kind.__name__, {})
]


def committed_bytes(kind: type[msgspec.Struct], format_: Format) -> bytes:
    text = COMMITTED[kind.__name__][format_.name]
    return text.encode() if format_ is Format.JSON else bytes.fromhex(text)


def test_golden_encoding_is_that_of_cdr() -> None:
    named = {name: one["encoding"] for name, one in COMMITTED.items() if "encoding" in one}

    assert named == {
        kind.__name__: encoding_of(kind, Format.CDR)
        for kind in spoken_types()
        if offers(kind, Format.CDR)
    }


def test_golden_bytes_are_those_of_the_types_that_travel() -> None:
    assert golden() == COMMITTED


@pytest.mark.parametrize(("kind", "format_"), SAMPLES)
def test_golden_bytes_are_what_encode_writes(kind: type[msgspec.Struct], format_: Format) -> None:
    assert encode(example_of(kind), format_) == committed_bytes(kind, format_)


@pytest.mark.parametrize(("kind", "format_"), SAMPLES)
def test_golden_bytes_are_read_and_written_again(
    kind: type[msgspec.Struct], format_: Format
) -> None:
    payload = committed_bytes(kind, format_)

    read = decode(kind, payload, encoding_of(kind, format_))

    assert encode(read, format_) == payload
