"""Encoding of responses, in the format of their requests."""

from dataclasses import dataclass

import msgspec

from zensim.proto.codec.message_codec import (
    Format,
    MalformedPayload,
    detect_format,
    encode,
    make_encoding,
)
from zensim.proto.network_protocols import ServiceCall


@dataclass(frozen=True)
class CachedResponse:
    """An encoded response."""

    payload: bytes
    encoding: str


def encode_response(call: ServiceCall, response: msgspec.Struct) -> CachedResponse:
    """Encode a response in the format of its request."""
    wanted = find_reply_format(call)
    try:
        payload = encode(response, wanted)
    except TypeError:
        # CDR cannot express some responses, such as claims with models.
        wanted = Format.MSGPACK
        payload = encode(response, wanted)
    return CachedResponse(payload, make_encoding(response, wanted))


def find_reply_format(call: ServiceCall) -> Format:
    """Find the format of a request, in which it is replied to."""
    try:
        return detect_format(call.start, call.encoding)
    except MalformedPayload:
        return Format.JSON if "json" in call.encoding else Format.MSGPACK
