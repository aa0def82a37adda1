"""The bus with real sessions over loopback."""

import errno
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

import pytest
import zenoh

from tests.integration.processes import eventually, free_endpoint
from zensim.proto import keys
from zensim.proto.bus import bus_session, session_files, session_opening
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import EndpointTaken, EndpointUnreachable, NoServer, SessionClosed
from zensim.proto.bus.bus_session import MAX_TAKEN, Bus, open_bus
from zensim.proto.bus.session_files import find_max_sessions
from zensim.proto.bus.zenoh_config import MAX_QUERY_BYTES, WILDCARD_HZ
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.endpoints import check_endpoint, with_free_port
from zensim.proto.messages.result_messages import Result, ResultCode, ServiceError
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, DeleteEntityResponse
from zensim.proto.messages.telemetry_messages import Info, InfoRequest
from zensim.proto.network_protocols import MAX_COMMAND_BYTES, MAX_REQUEST_BYTES
from zensim.proto.renewed_session import MAX_RETIRED
from zensim.proto.service_catalog import DELETE_ENTITY, INFO

if TYPE_CHECKING:
    from zensim.proto.network_protocols import Sample


@pytest.fixture
def router() -> Iterator[Bus]:
    with open_bus(BusConfig(mode="router", listen=(free_endpoint(),))) as bus:
        yield bus


@pytest.fixture
def client(router: Bus) -> Iterator[Bus]:
    with open_bus(BusConfig(connect=(router.endpoint,))) as bus:
        yield bus


class ReplyThread(threading.Thread):
    """Replies to every request once, like the loop of a server."""

    def __init__(self, bus: Bus, reply: bytes, encoding: str) -> None:
        super().__init__()
        self.seen: list[bytes] = []
        self._calls = bus.serve(keys.services("default"))
        self._reply = (reply, encoding)
        self._done = threading.Event()

    def __enter__(self) -> "ReplyThread":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._done.set()
        self.join()

    def run(self) -> None:
        while not self._done.wait(0.0002):
            for call in self._calls.take():
                self.seen.append(call.request_id)
                call.reply(*self._reply)


def replying(bus: Bus, response: Info | DeleteEntityResponse) -> ReplyThread:
    form = Format.MSGPACK
    return ReplyThread(bus, encode(response, form), make_encoding(response, form))


def test_samples_arrive_in_order_when_the_subscription_is_deep(router: Bus, client: Bus) -> None:
    listener = router.subscribe("r1/*", depth=100)
    publisher = client.advertise("r1/odom", "application/cdr")
    eventually(lambda: publisher.is_matched, 5.0, "matching")

    for number in range(10):
        publisher.send(bytes([number]))

    found: list[Sample] = []

    def have_all_arrived() -> bool:
        found.extend(listener.take())
        return len(found) == 10

    eventually(have_all_arrived, 5.0, "arriving")
    assert [sample.payload[0] for sample in found] == list(range(10))
    assert {sample.key for sample in found} == {"r1/odom"}
    assert {sample.encoding for sample in found} == {"application/cdr"}


def test_scans_of_a_fleet_that_are_published_at_once_all_arrive(router: Bus, client: Bus) -> None:
    with open_bus(BusConfig(connect=(router.endpoint,))) as listener:
        heard = listener.subscribe("*/scan", 1000)
        publishers = [client.advertise(f"r{number}/scan", "") for number in range(600)]
        eventually(lambda: all(one.is_matched for one in publishers), 5.0, "matching")

        for one in publishers:
            one.send(bytes(1508))
        arrived: list[Sample] = []

        def all_arrived() -> bool:
            arrived.extend(heard.take())
            return len(arrived) == len(publishers)

        eventually(all_arrived, 5.0, "all scans")


def test_newest_sample_is_kept_when_the_subscription_is_latest(router: Bus, client: Bus) -> None:
    latest, deep = router.subscribe("a"), router.subscribe("a", depth=10)
    publisher = client.advertise("a", "")
    eventually(lambda: publisher.is_matched, 5.0, "matching")

    for number in range(3):
        publisher.send(bytes([number]))

    eventually(lambda: any(sample.payload == b"\x02" for sample in deep.take()), 5.0, "arriving")
    newest = latest.newest()
    assert newest is not None
    assert newest.payload == b"\x02"
    assert latest.newest() is None


def test_newest_sample_of_each_key_is_kept_until_it_is_taken(router: Bus, client: Bus) -> None:
    subscription = client.subscribe_newest("fleet/**", 4096, lambda key: key.endswith("events"))
    publishers = [router.advertise(f"fleet/{one}", "") for one in ("a", "b", "events")]
    kept: list[tuple[str, bytes]] = []
    eventually(lambda: all(one.is_matched for one in publishers), 5.0, "a match")

    for number in range(50):
        for publisher in publishers:
            publisher.send(b"%d" % number)

    def has_the_last() -> bool:
        kept.extend((one.key, one.payload) for one in subscription.take())
        return ("fleet/events", b"49") in kept

    eventually(has_the_last, 5.0, "the last event")
    assert [payload for key, payload in kept if key == "fleet/events"] == [
        b"%d" % number for number in range(50)
    ]
    of_first = [payload for key, payload in kept if key == "fleet/a"]
    assert len(of_first) < 50
    assert of_first[-1] == b"49"


def test_publisher_tracks_matching_subscribers_across_changes_and_loss_of_the_router(
    router: Bus, client: Bus
) -> None:
    publisher = client.advertise("r1/odom", "")

    def is_alone() -> bool:
        return not publisher.is_matched

    assert is_alone()
    first, second = router.subscribe("r1/*"), router.subscribe("r1/odom")
    eventually(lambda: publisher.is_matched, 5.0, "matching")
    first.close()
    with open_bus(BusConfig(connect=(router.endpoint,))) as other:
        third = other.subscribe("**")
        second.close()
        eventually(lambda: publisher.is_matched, 5.0, "matching the third subscription")
        third.close()
    eventually(is_alone, 5.0, "being alone")
    fourth = router.subscribe("r1/odom")
    eventually(lambda: publisher.is_matched, 5.0, "matching again")
    router.close()
    eventually(is_alone, 5.0, f"the loss of the router with {fourth}")


def test_call_returns_the_typed_response(router: Bus, client: Bus) -> None:
    with replying(router, Info(world="w", steps=7)):
        info = client.call(INFO, InfoRequest(), world="default")

    assert (info.world, info.steps) == ("w", 7)


def test_call_raises_the_code_of_the_server_when_refused(router: Bus, client: Bus) -> None:
    refusal = DeleteEntityResponse(Result(ResultCode.NOT_FOUND, "entity 'x' does not exist"))
    with replying(router, refusal), pytest.raises(ServiceError, match="NOT_FOUND") as caught:
        client.call(DELETE_ENTITY, DeleteEntityRequest("x"), world="default")

    assert caught.value.code == ResultCode.NOT_FOUND


def test_call_carries_its_request_id(router: Bus, client: Bus) -> None:
    with replying(router, Info()) as server:
        client.call(INFO, InfoRequest(), world="default", request_id="again")

    assert server.seen == [b"again"]


def test_call_raises_when_no_server_is_present(client: Bus) -> None:
    with pytest.raises(NoServer, match="zensim serve"):
        client.call(INFO, InfoRequest(), world="default")


def test_call_of_another_world_names_those_that_there_are(router: Bus, client: Bus) -> None:
    with closing(router.token(keys.alive_server("wa"))), pytest.raises(NoServer, match=r"\bwa\b"):
        client.call(INFO, InfoRequest(), world="default")


def plain_session(router: Bus) -> zenoh.Session:
    config = zenoh.Config()
    config.insert_json5("mode", '"client"')
    config.insert_json5("connect/endpoints", f'["{router.endpoint}"]')
    return zenoh.open(config)


def test_many_requests_are_taken_in_batches(router: Bus) -> None:
    calls = router.serve(keys.services("default"))
    with plain_session(router) as session:
        waiting = [session.get(f"sim/default/s{number}") for number in range(MAX_TAKEN + 100)]
        batches: list[list[str]] = []
        while sum(map(len, batches)) < len(waiting):
            taken = eventually(lambda: calls.take() or None, 5.0, "coming")
            batches.append([call.name for call in taken])
            for call in taken:
                call.drop()

    assert max(map(len, batches)) <= MAX_TAKEN
    assert [name for batch in batches for name in batch] == [
        f"s{i}" for i in range(MAX_TAKEN + 100)
    ]


@pytest.mark.parametrize(("size", "start"), [(4096, b"{"), (4097, b"")])
def test_long_request_is_not_copied_to_see_its_format(router: Bus, size: int, start: bytes) -> None:
    calls = router.serve(keys.services("default"))
    with plain_session(router) as session:
        session.get("sim/default/info", payload=b"{" * size)
        (call,) = eventually(lambda: calls.take() or None, 5.0, "coming")
        assert call.start == start
        assert call.payload[:1] == call.start == b"{"
        call.drop()


def test_queries_above_the_limit_end_at_once_without_a_reply(router: Bus) -> None:
    calls = router.serve(keys.services("default"))
    with open_bus(BusConfig(connect=(router.endpoint,))) as client:
        replies = client.get("sim/default/info", 30.0, bytes(MAX_QUERY_BYTES + 1))

    assert replies == []
    assert calls.take() == []


def test_commands_above_the_limit_are_dropped_however_they_are_addressed(
    router: Bus, client: Bus
) -> None:
    received = router.subscribe("r1/cmd_vel", 8, MAX_COMMAND_BYTES)
    for key, size in (("r1/cmd_vel", 1), ("*/cmd_vel", 1), ("r1/cmd_vel", -1)):
        client.advertise(key, "text/plain").send(bytes(MAX_COMMAND_BYTES + size))

    samples = eventually(lambda: received.take() or None, 5.0, "coming")

    assert [len(sample.payload) for sample in samples] == [MAX_COMMAND_BYTES - 1]


def test_router_limits_the_rate_of_commands_to_all_robots_only(router: Bus, client: Bus) -> None:
    received = router.subscribe("r1/cmd_vel", 4 * WILDCARD_HZ)
    to_all, to_one = (client.advertise(key, "text/plain") for key in ("*/cmd_vel", "r1/cmd_vel"))
    samples: list[Sample] = []

    def all_of_one() -> bool:
        samples.extend(received.take())
        return sum(one.payload == b"one" for one in samples) == WILDCARD_HZ

    began_s = time.monotonic()
    for publisher, text in ((to_all, b"all"), (to_one, b"one")):
        for _ in range(WILDCARD_HZ):
            publisher.send(text)
    eventually(all_of_one, 5.0, "coming")

    passed = len(samples) - WILDCARD_HZ
    assert 1 <= passed <= 1 + (time.monotonic() - began_s) * WILDCARD_HZ


def test_request_names_its_session(router: Bus, client: Bus) -> None:
    calls = router.serve(keys.services("default"))
    thread = threading.Thread(target=client.get, args=("sim/default/info",))
    thread.start()
    (call,) = eventually(lambda: calls.take() or None, 5.0, "coming")
    call.drop()
    thread.join()

    assert call.client == client.zid


def test_replies_that_wait_are_sent_before_the_session_closes(router: Bus, client: Bus) -> None:
    samples: list[Sample] = []
    is_closed = threading.Event()

    def query() -> None:
        # A query that comes to the router before the queryable ends without a reply.
        while not samples and not is_closed.wait(0.005):
            samples.extend(client.get("a/b", 10.0))

    thread = threading.Thread(target=query)
    thread.start()
    try:
        with open_bus(BusConfig(connect=(router.endpoint,))) as server:
            calls = server.serve("a/b")
            (call,) = eventually(lambda: calls.take() or None, 5.0, "coming")
            call.reply(b"last words", "text/plain")
    finally:
        is_closed.set()
        thread.join()

    assert [sample.payload for sample in samples] == [b"last words"]


def test_call_times_out_when_the_server_never_replies(router: Bus, client: Bus) -> None:
    calls = router.serve(keys.services("default"))

    with pytest.raises(TimeoutError, match=r"0\.2 s"):
        client.call(INFO, InfoRequest(), world="default", timeout_s=0.2)

    for call in calls.take():
        call.drop()


def test_begun_call_returns_the_response_when_it_has_come(router: Bus, client: Bus) -> None:
    with replying(router, Info(world="default")) as replies:
        begun = client.begin_call(INFO, InfoRequest(), world="default")

        response = eventually(begun.poll, 5.0, "the response")

    assert response.world == "default"
    assert len(set(replies.seen)) == 1


def test_begun_call_raises_when_no_server_is_present(client: Bus) -> None:
    begun = client.begin_call(INFO, InfoRequest(), world="default")

    with pytest.raises(NoServer):
        eventually(begun.poll, 5.0, "an error")


def test_call_of_a_session_that_was_closed_is_an_error_of_the_network(client: Bus) -> None:
    client.close()

    with pytest.raises(SessionClosed):
        client.call(INFO, InfoRequest(), world="w")
    with pytest.raises(SessionClosed):
        client.begin_call(INFO, InfoRequest(), world="w")


def test_begun_call_times_out_when_the_server_never_replies(router: Bus, client: Bus) -> None:
    queue = router.serve(keys.services("default"))
    begun = client.begin_call(INFO, InfoRequest(), world="default", timeout_s=0.2)

    with pytest.raises(TimeoutError):
        eventually(begun.poll, 5.0, "an error")

    queue.close()


def test_begun_call_that_is_refused_raises_the_code(router: Bus, client: Bus) -> None:
    refused = DeleteEntityResponse(Result(ResultCode.NOT_FOUND, "no"))
    with replying(router, refused):
        begun = client.begin_call(DELETE_ENTITY, DeleteEntityRequest("r1"), world="default")
        with pytest.raises(ServiceError) as caught:
            eventually(begun.poll, 5.0, "an error")

    assert caught.value.code == ResultCode.NOT_FOUND


def test_watch_of_subscribers_knows_those_within_its_patterns(router: Bus, client: Bus) -> None:
    watch = client.watch_subscribers(("*/odom",))
    first = router.subscribe("box_bot17/odom", 8)
    with client.open_session() as other:
        second = other.subscribe("box_bot2/odom", 8)
        eventually(lambda: watch.has_subscribers("box_bot2/odom"), 5.0, "matching")

        matched = [
            key
            for key in ("*", "box_bot1$*", "box_bot17$*", "box_bot17", "box_bot18", "box_bot3$*")
            if watch.has_subscribers(f"{key}/odom")
        ]
        second.close()
    first.close()

    assert matched == ["*", "box_bot1$*", "box_bot17$*", "box_bot17"]
    eventually(lambda: not watch.has_subscribers("*/odom"), 5.0, "no matching")
    watch.close()


def test_undeclared_publisher_of_a_watch_reaches_subscribers(router: Bus, client: Bus) -> None:
    watch = client.watch_subscribers(("*/odom",))
    received = router.subscribe("r1/odom", 8)
    publisher = watch.advertise("r1/odom", "application/cdr")
    eventually(lambda: watch.has_subscribers("r1/odom"), 5.0, "matching")

    publisher.send(b"1")
    publisher.send(b"2", b"attached")
    publisher.send(b"3", b"", client.stamp())

    found: list[Sample] = []

    def take_all() -> bool:
        found.extend(received.take())
        return len(found) == 3

    eventually(take_all, 5.0, "arriving")
    assert [sample.payload for sample in found] == [b"1", b"2", b"3"]
    assert {sample.encoding for sample in found} == {"application/cdr"}
    assert found[1].attachment == b"attached"
    watch.close()


def test_call_is_refused_before_sending_when_it_exceeds_the_limit(router: Bus) -> None:
    config = BusConfig(connect=(router.endpoint,), max_message_bytes=1000)
    with open_bus(config) as client, pytest.raises(ServiceError) as refused:
        client.call(DELETE_ENTITY, DeleteEntityRequest("x" * 2000), world="default")

    assert refused.value.message.startswith("request.size: ")


def test_call_that_the_server_would_refuse_for_its_size_is_not_sent(client: Bus) -> None:
    with pytest.raises(ServiceError) as refused:
        client.call(DELETE_ENTITY, DeleteEntityRequest("x" * MAX_REQUEST_BYTES), world="default")

    assert refused.value.message.startswith("request.size: ")


def test_all_calls_get_replies_while_sessions_open_and_close(router: Bus, client: Bus) -> None:
    done = threading.Event()

    def open_and_close_sessions() -> None:
        while not done.is_set():
            open_bus(BusConfig(connect=(router.endpoint,))).close()

    visitor = threading.Thread(target=open_and_close_sessions)
    with replying(router, Info()):
        visitor.start()
        try:
            for _ in range(1000):
                client.call(INFO, InfoRequest(), world="default")
        finally:
            done.set()
            visitor.join()


def test_token_changes_are_observed(router: Bus, client: Bus) -> None:
    watch = router.watch_tokens("alive/*")
    token = client.token("alive/a")

    assert eventually(lambda: watch.take() or None, 5.0, "coming") == [("alive/a", True)]
    assert router.list_tokens("alive/*") == ["alive/a"]
    token.close()
    assert eventually(lambda: watch.take() or None, 5.0, "going") == [("alive/a", False)]


def test_all_replies_are_collected_when_many_reply(router: Bus, client: Bus) -> None:
    keys_served = [f"many/k{number}" for number in range(50)]
    queues = [router.serve(key) for key in keys_served]
    done = threading.Event()

    def answer() -> None:
        while not done.wait(0.001):
            for key, queue in zip(keys_served, queues, strict=True):
                for call in queue.take():
                    call.reply(key.encode(), "", key)

    server = threading.Thread(target=answer)
    server.start()
    try:
        found = client.get("many/*", timeout_s=60.0)
    finally:
        done.set()
        server.join()
    assert sorted(sample.payload.decode() for sample in found) == sorted(keys_served)


def test_open_fails_when_no_router_listens() -> None:
    config = BusConfig(connect=(free_endpoint(),), open_timeout_s=0.2)

    with pytest.raises(EndpointUnreachable, match="tcp/127"):
        open_bus(config)


def test_open_says_that_the_router_is_full(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(session_files, "MAX_SESSIONS", 1)
    with open_bus(BusConfig(mode="router", listen=("tcp/127.0.0.1:0",))) as router:
        config = BusConfig(connect=(router.endpoint,), open_timeout_s=0.5)

        with open_bus(config), pytest.raises(EndpointUnreachable, match="full"):
            open_bus(config)


def test_sessions_open_beside_handshakes_that_do_not_end(router: Bus) -> None:
    host, port = router.endpoint.removeprefix("tcp/").split(":")

    with ExitStack() as stack:
        for _ in range(150):
            stack.enter_context(socket.create_connection((host, int(port))))
        with open_bus(BusConfig(connect=(router.endpoint,), open_timeout_s=60.0)) as client:
            assert client.zid


@pytest.mark.parametrize(("file_limit", "sessions"), [(1024, 412), (100, 1), (1 << 16, 4000)])
def test_router_leaves_open_files_for_its_server(file_limit: int, sessions: int) -> None:
    assert find_max_sessions(file_limit) == sessions


def test_open_fails_when_the_endpoint_is_taken(router: Bus) -> None:
    with pytest.raises(EndpointTaken, match=router.endpoint):
        open_bus(BusConfig(mode="router", listen=(router.endpoint,)))


@pytest.mark.parametrize("endpoint", ["", "7447", "tcp/localhost", "tcp/h:99999", "ftp/h:1", "x"])
def test_endpoint_is_refused_when_it_is_none(endpoint: str) -> None:
    with pytest.raises(ValueError, match="tcp/127"):
        check_endpoint(endpoint)


def test_port_is_chosen_when_it_is_0() -> None:
    assert not with_free_port("tcp/127.0.0.1:0").endswith(":0")
    assert with_free_port("tcp/127.0.0.1:7447") == "tcp/127.0.0.1:7447"


@pytest.mark.parametrize("host", ["127.0.0.1", "0.0.0.0", "[::1]"])
def test_chosen_port_is_kept_for_a_router(host: str) -> None:
    endpoint = with_free_port(f"tcp/{host}:0")
    family = socket.AF_INET6 if ":" in host else socket.AF_INET

    with socket.socket(family) as other, pytest.raises(OSError) as refusal:  # noqa: PT011
        other.bind((host.strip("[]"), int(endpoint.rpartition(":")[2])))

    assert refusal.value.errno == errno.EADDRINUSE
    with open_bus(BusConfig(mode="router", listen=(endpoint,))) as router:
        assert router.endpoint == endpoint


def test_router_resets_connections_that_take_no_data(monkeypatch: pytest.MonkeyPatch) -> None:
    limits: list[tuple[int, int]] = []
    monkeypatch.setattr(
        session_opening, "limit_unacknowledged_time", lambda *one: limits.append(one)
    )
    endpoint = free_endpoint()

    with open_bus(BusConfig(mode="router", listen=(endpoint,))):
        pass

    assert limits == [(int(endpoint.rpartition(":")[2]), session_opening.MOST_UNACKNOWLEDGED_MS)]


def test_declarations_outlive_the_sessions_that_are_replaced(
    router: Bus, client: Bus, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bus_session, "RENEW_AFTER", 20)
    messages, tokens = client.subscribe("kept/odom", 10_000), client.watch_tokens("sim/**")
    sent = 0
    with open_bus(BusConfig(connect=(router.endpoint,))) as bus:
        publisher, _ = bus.advertise("kept/odom", ""), bus.token("sim/kept")
        eventually(lambda: publisher.is_matched, 10.0, "a subscriber")
        watch = router.watch_links()
        opened = 0
        while opened < 3 + 2 * MAX_RETIRED:
            assert publisher.is_matched
            publisher.send(b"%d" % sent)
            sent += 1
            bus.token(f"sim/{sent}").close()
            bus.advertise(f"r{sent}/odom", "").close()
            opened += sum(is_open for *_, is_open in watch.take())
        found: list[bytes] = []

        def has_all() -> bool:
            found.extend(one.payload for one in messages.take())
            return len(found) >= sent

        eventually(has_all, 10.0, "all messages")
        eventually(lambda: client.list_tokens("sim/*") == ["sim/kept"], 10.0, "one token")

    changes = [is_alive for key, is_alive in tokens.take() if key == "sim/kept"]
    assert sorted(found, key=int) == [b"%d" % number for number in range(sent)]
    assert changes[0] is True
    assert False not in changes[:-1]
