"""The committed golden bytes decode to their sample messages."""

import json
from typing import TypeAlias

import msgspec
import pytest

from zensim.proto.codec.message_codec import Format, decode, encode, make_encoding, supports_format
from zensim.proto.sample_messages import make_sample_message
from zensim.proto.schema import SCHEMAS, list_top_level_types, make_golden

Golden: TypeAlias = dict[str, dict[str, str]]

COMMITTED: Golden = json.loads((SCHEMAS / "golden.json").read_text(encoding="utf-8"))
SAMPLES = [
    pytest.param(kind, format_, id=f"{kind.__name__} in {format_.name}")
    for kind in list_top_level_types()
    for format_ in Format
    if format_.name in COMMITTED.get(kind.__name__, {})
]


def committed_bytes(kind: type[msgspec.Struct], format_: Format) -> bytes:
    text = COMMITTED[kind.__name__][format_.name]
    return text.encode() if format_ is Format.JSON else bytes.fromhex(text)


def test_golden_encoding_is_cdr() -> None:
    named = {name: one["encoding"] for name, one in COMMITTED.items() if "encoding" in one}

    assert named == {
        kind.__name__: make_encoding(kind, Format.CDR)
        for kind in list_top_level_types()
        if supports_format(kind, Format.CDR)
    }


def test_golden_bytes_cover_all_message_types() -> None:
    assert make_golden() == COMMITTED


@pytest.mark.parametrize(("kind", "format_"), SAMPLES)
def test_golden_bytes_match_encode(kind: type[msgspec.Struct], format_: Format) -> None:
    assert encode(make_sample_message(kind), format_) == committed_bytes(kind, format_)


@pytest.mark.parametrize(("kind", "format_"), SAMPLES)
def test_golden_bytes_survive_a_round_trip(kind: type[msgspec.Struct], format_: Format) -> None:
    payload = committed_bytes(kind, format_)

    read = decode(kind, payload, make_encoding(kind, format_))

    assert encode(read, format_) == payload
