"""Loop: formats of replies, retries, gets of topics, and malformed requests."""

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes import MemoryCall
from tests.sim_server.fakes import ServerFixture, a_server, answer_of, names_in
from zensim.proto.codec.message_codec import Format, detect_format, encode, make_encoding
from zensim.proto.messages.entity_messages import GetEntitiesRequest, GetEntitiesResponse
from zensim.proto.messages.result_messages import ResultCode, SpawnCode
from zensim.proto.messages.simulation_messages import State, StepSimulationRequest
from zensim.proto.messages.spawn_messages import (
    DeleteEntityRequest,
    DeleteEntityResponse,
    Resource,
    SpawnEntityOrder,
)
from zensim.proto.messages.telemetry_messages import (
    GetModelsRequest,
    GetModelsResponse,
    Info,
    InfoRequest,
    Snapshot,
    Stats,
    WorldClock,
)
from zensim.proto.network_protocols import MAX_REQUEST_BYTES
from zensim.proto.service_catalog import SERVICES
from zensim.sim_server.physics.engine import EngineLost

FORMATS = list(Format)
BOX_BOT = Resource("box_bot")


def refusal_in(call: MemoryCall) -> tuple[int, str]:
    response = answer_of(call, DeleteEntityResponse)
    assert isinstance(response, DeleteEntityResponse)
    return response.result.result, response.result.error_message


def served(server: ServerFixture, service: str, payload: bytes, encoding: str = "") -> MemoryCall:
    call = server.send(service, payload, encoding)
    server.loop.turn()
    return call


@pytest.mark.parametrize("wanted", FORMATS)
def test_loop_replies_in_the_format_of_the_request(wanted: Format) -> None:
    server = a_server("r0", "r1")
    call = server.request("get_entities", GetEntitiesRequest(), wanted)

    server.loop.turn()

    assert call.answers[0].encoding == make_encoding(GetEntitiesResponse, wanted)
    assert answer_of(call, GetEntitiesResponse) == GetEntitiesResponse(entities=("r0", "r1"))


@pytest.mark.parametrize("wanted", FORMATS)
def test_loop_replies_in_the_format_of_the_first_byte(wanted: Format) -> None:
    call = served(a_server("r0"), "get_entities", encode(GetEntitiesRequest(), wanted))

    assert call.answers[0].encoding == make_encoding(GetEntitiesResponse, wanted)


@pytest.mark.parametrize("wanted", FORMATS)
def test_loop_refuses_in_the_format_of_the_request(wanted: Format) -> None:
    server = a_server()
    call = server.request("delete_entity", DeleteEntityRequest("r9"), wanted)

    server.loop.turn()

    assert call.answers[0].encoding == make_encoding(DeleteEntityResponse, wanted)
    assert refusal_in(call)[0] == ResultCode.NOT_FOUND


@pytest.mark.parametrize("wanted", FORMATS)
def test_loop_reads_an_empty_request_as_defaults(wanted: Format) -> None:
    call = served(a_server("r0"), "get_entities", b"", wanted.value)

    assert call.answers[0].encoding == make_encoding(GetEntitiesResponse, wanted)
    assert answer_of(call, GetEntitiesResponse) == GetEntitiesResponse(entities=("r0",))


def test_loop_replies_in_messagepack_when_cdr_cannot_express_the_response() -> None:
    call = served(a_server("r0"), "get_models", encode(GetModelsRequest(), Format.CDR))

    assert call.answers[0].encoding == Format.MSGPACK.value
    response = answer_of(call, GetModelsResponse)
    assert isinstance(response, GetModelsResponse)
    assert [one.entity for one in response.entities] == ["r0"]


@pytest.mark.parametrize("wanted", [Format.MSGPACK, Format.JSON])
def test_loop_refuses_an_unknown_service_and_lists_the_known(wanted: Format) -> None:
    call = served(a_server(), "make_coffee", encode(InfoRequest(), wanted))

    code, message = refusal_in(call)
    assert code == ResultCode.FEATURE_UNSUPPORTED
    assert "'make_coffee'" in message
    assert set(SERVICES) <= set(message.replace(",", " ").split())
    assert call.answers[0].encoding == wanted.value


@pytest.mark.parametrize(
    ("payload", "named"),
    [
        (b"{", "JSON"),
        (b'{"entity": 5}', "entity"),
        (b"\x81", "MSGPACK"),
        (b"\x81\xa6entity\x05", "entity"),
        (b"\x00\x01\x00\x00\xff\xff\xff\xff", "CDR"),
        (b"\x00", "CDR"),
        (b"hello", "0x68"),
    ],
)
def test_loop_refuses_a_malformed_request_with_its_reason(payload: bytes, named: str) -> None:
    server = a_server("r0")

    call = served(server, "delete_entity", payload)

    code, message = refusal_in(call)
    assert code == ResultCode.OPERATION_FAILED
    assert named in message
    assert names_in(server.world) == ["r0"]


def test_loop_refuses_bytes_of_another_encoding() -> None:
    call = served(a_server(), "delete_entity", b'{"entity": "r0"}', "application/cdr")

    code, message = refusal_in(call)
    assert code == ResultCode.OPERATION_FAILED
    assert "application/cdr" in message


@pytest.mark.parametrize("kind", [Info, Snapshot, Stats, WorldClock], ids=lambda one: one.__name__)
def test_loop_replies_with_topics(kind: type[msgspec.Struct]) -> None:
    name = {Info: "info", Snapshot: "snapshot", Stats: "stats", WorldClock: "clock"}[kind]
    server = a_server("r0")

    for wanted in (Format.MSGPACK, Format.JSON):
        call = served(server, name, b"", wanted.value)

        assert isinstance(answer_of(call, kind), kind)
        assert call.answers[0].encoding == wanted.value


def test_loop_replies_on_its_own_key() -> None:
    server = a_server("r0")
    call = MemoryCall("sim/*/info", b"", "", b"")
    server.inbox.calls.append(call)

    server.loop.turn()

    assert call.answers[0].key == "sim/default/info"


@pytest.mark.parametrize("key", ["sim/default/*", "sim/**", "**", "sim/default/$*_entity"])
def test_loop_replies_to_a_pattern_that_names_no_service(key: str) -> None:
    server = a_server("r0")
    call = MemoryCall(key, b"", "", b"")
    server.inbox.calls.append(call)

    server.loop.turn()

    assert refusal_in(call)[0] == ResultCode.FEATURE_UNSUPPORTED


def test_loop_counts_requests() -> None:
    server = a_server()
    for name in ("info", "info", "nonsense", "clock"):
        server.send(name, b"")

    server.loop.turn()

    assert server.parts.pacing.loop_stats.requests == 4


def test_loop_replies_in_the_order_of_requests() -> None:
    server = a_server("r0")
    before = server.request("get_entities", GetEntitiesRequest())
    server.request("delete_entity", DeleteEntityRequest("r0"))
    after = server.request("get_entities", GetEntitiesRequest())

    server.loop.turn()

    assert answer_of(before, GetEntitiesResponse) == GetEntitiesResponse(entities=("r0",))
    assert answer_of(after, GetEntitiesResponse) == GetEntitiesResponse(entities=())


def test_loop_deletes_once_when_a_delete_is_sent_again() -> None:
    server = a_server("r0")
    first = server.request("delete_entity", DeleteEntityRequest("r0"))
    second = server.request("delete_entity", DeleteEntityRequest("r0"))
    first.request_id = second.request_id = b"the same"

    server.loop.turn()

    assert refusal_in(first)[0] == refusal_in(second)[0] == ResultCode.OK


def test_loop_returns_models_as_bytes_of_any_size() -> None:
    server = a_server(*(f"r{i}" for i in range(50)))
    call = server.request("get_models", GetModelsRequest())

    server.loop.turn()

    assert len(call.answers[0].payload) > 1000


@given(
    service=st.sampled_from([*SERVICES, "clock", "stats", "snapshot", "*", "", "é"]),
    payload=st.one_of(
        st.binary(max_size=60),
        st.binary(max_size=60).map(lambda tail: b"\x00\x01\x00\x00" + tail),
        st.binary(max_size=60).map(lambda tail: b"{" + tail),
        st.binary(max_size=60).map(lambda tail: b"\x81" + tail),
    ),
    encoding=st.sampled_from(
        ["", "application/cdr", "application/cdr;x/y", "application/json", "text/plain", "💥"]
    ),
    request_id=st.sampled_from([b"", b"1", b"\xff" * 40]),
)
def test_loop_replies_to_any_bytes(
    service: str, payload: bytes, encoding: str, request_id: bytes
) -> None:
    server = a_server("r0", factor=0.0)
    call = server.send(service, payload, encoding)
    call.request_id = request_id

    server.loop.turn()

    (answer,) = call.answers
    assert detect_format(answer.payload, answer.encoding) in FORMATS
    # An empty payload is an empty request, which rightly pauses, stops or unloads.
    assert server.world.clock.steps == (server.world.clock.state == State.PLAYING)


def test_loop_replies_to_a_step_request_by_any_name_of_the_world() -> None:
    server = a_server()
    server.world.clock.pause()
    call = MemoryCall(
        "sim/*/step_simulation", encode(StepSimulationRequest(2), Format.JSON), "", b""
    )
    server.inbox.calls.append(call)

    for _ in range(2):
        server.loop.turn()

    assert call.answers[0].key == "sim/default/step_simulation"
    assert server.world.clock.steps == 2


@pytest.mark.parametrize(
    ("service", "code"),
    [
        ("spawn_entity", SpawnCode.RESOURCE_PARSE_ERROR),
        ("get_entities", ResultCode.OPERATION_FAILED),
        ("make_coffee", ResultCode.OPERATION_FAILED),
    ],
)
def test_loop_refuses_a_request_that_is_too_large_to_decode(service: str, code: int) -> None:
    call = served(a_server("r0"), service, b"\xff" * (MAX_REQUEST_BYTES + 1))

    assert refusal_in(call)[0] == code
    assert refusal_in(call)[1].startswith(f"request.size: a request of {MAX_REQUEST_BYTES + 1}")


def test_request_of_another_service_does_not_replace_a_pending_one() -> None:
    server = a_server()
    server.world.clock.pause()
    steps = server.request("step_simulation", StepSimulationRequest(2))
    other = server.request("get_entities", GetEntitiesRequest())
    steps.request_id = other.request_id = b"same"

    for _ in range(6):
        server.loop.turn()

    assert (len(steps.answers), len(other.answers)) == (1, 1)


@pytest.mark.parametrize(
    "error", [OSError(24, "Too many open files"), RuntimeError("a defect"), KeyError("gone")]
)
@pytest.mark.parametrize("is_deferred", [False, True])
def test_loop_refuses_a_request_whose_handler_fails_and_goes_on(
    monkeypatch: pytest.MonkeyPatch, error: Exception, *, is_deferred: bool
) -> None:
    server = a_server("r0")

    def fail(*_: object) -> bool:
        raise error

    if is_deferred:
        monkeypatch.setattr(server.parts.descriptions.provider, "is_parsed", fail)
        call = server.request("spawn_entity", SpawnEntityOrder("r1", entity_resource=BOX_BOT))
    else:
        monkeypatch.setattr(server.world, "delete", fail)
        call = server.request("delete_entity", DeleteEntityRequest("r0"))
    server.loop.turn()
    info = server.request("info", InfoRequest())
    server.loop.turn()

    response = answer_of(call, SERVICES[call.name].response)
    assert response.result.error_message.startswith("server.fault: ")  # type: ignore[attr-defined]
    assert info.is_over


def test_loop_ends_when_the_engine_is_lost_in_a_handler(monkeypatch: pytest.MonkeyPatch) -> None:
    server = a_server("r0")

    def fail(*_: object) -> None:
        raise EngineLost("gone")

    monkeypatch.setattr(server.world, "delete", fail)
    server.request("delete_entity", DeleteEntityRequest("r0"))

    with pytest.raises(EngineLost):
        server.loop.turn()
