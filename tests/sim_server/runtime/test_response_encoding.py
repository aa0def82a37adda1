"""Responses are encoded in the format of their requests."""

from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import MemoryCall
from zensim.proto.codec.message_codec import Format
from zensim.sim_server.runtime.response_encoding import find_reply_format

if TYPE_CHECKING:
    from zensim.proto.network_protocols import ServiceCall


@pytest.mark.parametrize(
    ("size", "form"), [(2, Format.JSON), (4096, Format.JSON), (4097, Format.MSGPACK)]
)
def test_format_of_a_request_of_4096_bytes_at_most_is_detected(size: int, form: Format) -> None:
    payload = b"{" + b" " * (size - 2) + b"}"
    call = cast("ServiceCall", MemoryCall("sim/default/info", payload, "", b""))

    assert find_reply_format(call) is form
