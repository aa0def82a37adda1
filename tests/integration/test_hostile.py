"""Hostile descriptions sent to a live server: each gets a reply while the world keeps running."""

from collections.abc import Iterator

import msgspec
import pytest
import zenoh

from tests.hostile.case import Case
from tests.hostile.corpus import corpus
from tests.integration.processes import Server, eventually, serving
from zensim.proto.bus.zenoh_config import MAX_QUERY_BYTES
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.proto.network_protocols import MAX_REQUEST_BYTES

EVERY = 6
CASES = [case for case in corpus() if case.slug != "xml.encoding"][::EVERY]
"""Lone surrogates cannot be encoded."""
GOOD = SpawnEntityOrder("good", entity_resource=Resource(uri="box_bot"))
DEEP = 100_000
MANY = b"\xff\xff\xff\xff"
BOMBS = {
    "array_of_4_g": b"\xdd" + MANY,
    "map_of_4_g": b"\xdf" + MANY,
    "text_of_4_g": b"\xdb" + MANY,
    "bytes_of_4_g": b"\xc6" + MANY,
    "extension_of_4_g": b"\xc9" + MANY + b"\x01",
    "deep_arrays": b"\x91" * DEEP,
    "deep_maps": b"\x81\xa1a" * DEEP,
    "deep_json": b'{"a":' * DEEP,
    "name_of_wrong_type": msgspec.msgpack.encode({"name": 7}),
    "resource_of_wrong_type": msgspec.msgpack.encode({"entity_resource": ["box_bot"]}),
    "text_as_bytes": msgspec.msgpack.encode({"entity_resource": {"resource_string": b"\xff"}}),
    "text_that_is_no_utf8": b"\x81\xa4name\xa2\xff\xfe",
    "pose_of_wrong_type": msgspec.msgpack.encode({"initial_pose": "here"}),
    "same_key_1000_times": b"\xde\x03\xe8" + b"\xa4name\xa1a" * 1000,
}


@pytest.fixture(scope="module")
def server() -> Iterator[Server]:
    with serving() as found:
        # The parser process starts slowly on shared cores.
        eventually(lambda: answer_to(found, GOOD) == "", 60.0, "a first spawn")
        yield found


@pytest.fixture(autouse=True)
def advancing(server: Server) -> Iterator[None]:
    before = server.steps()
    yield
    eventually(lambda: server.steps() > before, 5.0, "stepping")
    assert server.process.poll() is None
    assert server.client.entities() == ()


@pytest.mark.parametrize("case", CASES, ids=lambda case: ascii(case.name))
def test_server_replies_to_a_hostile_description_and_keeps_stepping(
    server: Server, case: Case
) -> None:
    order = SpawnEntityOrder("hostile", entity_resource=Resource(resource_string=case.text))

    response = answer_to(server, order)

    slug = (
        "request.size"
        if len(case.text.encode("utf-8", "surrogatepass")) > MAX_REQUEST_BYTES
        else case.slug
    )
    assert response.startswith(f"{slug}: ") if slug else response == ""


def answer_to(server: Server, order: SpawnEntityOrder) -> str:
    """Spawn and delete; return the message of the refusal, empty if accepted."""
    try:
        report = server.client.spawn(order)
    except ServiceError as refusal:
        return refusal.message
    server.client.delete(report.entity_name)
    return ""


@pytest.mark.parametrize("name", BOMBS)
def test_server_refuses_an_expansion_bomb_and_keeps_stepping(server: Server, name: str) -> None:
    assert b"result" in reply_to_bytes(server, BOMBS[name])


@pytest.mark.parametrize("size", [MAX_REQUEST_BYTES + 1, MAX_QUERY_BYTES - 1000])
def test_server_refuses_a_large_request_by_its_size(server: Server, size: int) -> None:
    assert b"request.size: " in reply_to_bytes(server, bytes(size))


@pytest.mark.parametrize("size", [17 << 20, 60 << 20])
def test_request_above_the_routers_limit_ends_at_once_without_a_reply(
    server: Server, size: int
) -> None:
    assert reply_to_bytes(server, bytes(size)) == b""


def reply_to_bytes(server: Server, payload: bytes) -> bytes:
    """Send bytes as a foreign client does; return the reply."""
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{server.endpoint}"]')
    config.insert_json5("scouting/multicast/enabled", "false")
    with zenoh.open(config) as session:
        replies = list(session.get("sim/default/spawn_entity", payload=payload, timeout=60.0))
    return b"".join(bytes(reply.ok.payload.to_bytes()) for reply in replies if reply.ok)
