"""What stands in for a network session behaves as one over loopback."""

import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress

import pytest
import zenoh
from hypothesis import given
from hypothesis import strategies as st

from tests.fakes import MemoryBus
from tests.integration.processes import eventually, free_endpoint
from zensim.proto import keys
from zensim.proto.bus.bus_config import BusConfig
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.bus.bus_session import Bus, open_bus
from zensim.proto.codec.message_codec import Format, encode, make_encoding
from zensim.proto.keys import intersect
from zensim.proto.messages.result_messages import Result, ResultCode, ServiceError
from zensim.proto.messages.spawn_messages import DeleteEntityRequest, DeleteEntityResponse
from zensim.proto.network_protocols import Query, Sample, Subscription, TopicNetwork
from zensim.proto.service_catalog import DELETE_ENTITY

WITHIN_S = 60.0
KINDS = ("zenoh", "memory")


class Pair:
    """Two ends of a network: one publishes and queries, the other subscribes and serves."""

    def __init__(self, near: TopicNetwork, far: TopicNetwork) -> None:
        self.near, self.far = near, far

    def wait(self, condition: Callable[[], bool], what: str) -> None:
        """Wait until a condition holds; at once where nothing is between the ends."""
        if isinstance(self.near, Bus):
            eventually(condition, WITHIN_S, what)
        assert condition(), what

    def query(self, key: str, serve: Callable[[], None]) -> list[Sample]:
        """Query a key from the near end while `serve` handles queries at the far end."""
        if isinstance(self.near, MemoryBus):
            self.near.pumps.append(serve)
            return self.near.get(key)
        found: list[list[Sample]] = []
        assert isinstance(self.near, Bus)
        get = self.near.get
        thread = threading.Thread(target=lambda: found.append(get(key, WITHIN_S)))
        thread.start()
        while thread.is_alive():
            serve()
        return found[0]


@pytest.fixture(scope="module")
def router() -> Iterator[Bus]:
    with open_bus(BusConfig(mode="router", listen=(free_endpoint(),))) as bus:
        yield bus


@contextmanager
def paired(kind: str, router: Bus) -> Iterator[Pair]:
    if kind == "zenoh":
        config = BusConfig(connect=(router.endpoint,))
        with open_bus(config) as near, open_bus(config) as far:
            yield Pair(near, far)
        return
    one = MemoryBus()
    yield Pair(one, one)


@pytest.fixture(params=KINDS)
def pair(request: pytest.FixtureRequest, router: Bus) -> Iterator[Pair]:
    with paired(request.param, router) as made:
        yield made


def query_until_served(
    pair: Pair, key: str, serve: Callable[[], None], served: Sequence[object]
) -> list[Sample]:
    """Query until something is served: a query before the queryable ends without a reply."""
    found: list[Sample] = []

    def is_served() -> bool:
        if not served:
            found.extend(pair.query(key, serve))
        return bool(served)

    pair.wait(is_served, "a served query")
    return found


def take_all(pair: Pair, subscription: Subscription, count: int) -> list[Sample]:
    found: list[Sample] = []

    def has_all() -> bool:
        found.extend(subscription.take())
        return len(found) >= count

    pair.wait(has_all, f"{count} messages")
    return found


def test_messages_arrive_in_order_as_they_were_published(pair: Pair) -> None:
    subscription = pair.far.subscribe("r1/*", 10)
    publisher = pair.near.advertise("r1/odom", "application/cdr")
    pair.wait(lambda: publisher.is_matched, "a subscriber")

    for number in range(4):
        publisher.send(bytes([number]), b"attached" if number % 2 else b"")

    assert take_all(pair, subscription, 4) == [
        Sample("r1/odom", bytes([n]), "application/cdr", b"attached" if n % 2 else b"")
        for n in range(4)
    ]
    assert subscription.take() == []
    assert subscription.newest() is None


def test_held_messages_arrive_in_order_after_the_block(pair: Pair) -> None:
    subscription = pair.far.subscribe("r1/*", 10)
    odom, scan = pair.near.advertise("r1/odom", ""), pair.near.advertise("r1/scan", "")
    pair.wait(lambda: odom.is_matched and scan.is_matched, "subscribers")

    with pair.near.hold_messages():
        odom.send(b"1")
        scan.send(b"2", b"attached")
        pair.near.send_held()
        odom.send(b"3", stamp=pair.near.stamp())
        odom.close()
    scan.send(b"4")

    found = [(one.payload, one.attachment) for one in take_all(pair, subscription, 4)]
    assert found == [(b"1", b""), (b"2", b"attached"), (b"3", b""), (b"4", b"")]


def test_messages_are_held_until_the_block_ends_or_they_are_sent(router: Bus) -> None:
    with paired("zenoh", router) as pair:
        subscription = pair.far.subscribe("r1/*", 10)
        held, other = pair.near.advertise("r1/odom", ""), pair.far.advertise("r1/scan", "")
        pair.wait(lambda: held.is_matched, "a subscriber")

        with suppress(RuntimeError), pair.near.hold_messages():
            held.send(b"1")
            other.send(b"2")
            assert [one.payload for one in take_all(pair, subscription, 1)] == [b"2"]
            raise RuntimeError

        assert [one.payload for one in take_all(pair, subscription, 1)] == [b"1"]


def test_messages_of_undeclared_publishers_are_held_too(router: Bus) -> None:
    with paired("zenoh", router) as pair:
        assert isinstance(pair.near, Bus)
        subscription = pair.far.subscribe("r1/*", 10)
        with closing(pair.near.watch_subscribers(["*/odom"])) as watch:
            publisher = watch.advertise("r1/odom", "")
            pair.wait(lambda: watch.has_subscribers("r1/odom"), "a subscriber")
            other = pair.far.advertise("r1/scan", "")

            with pair.near.hold_messages():
                publisher.send(b"1")
                other.send(b"2")
                first = take_all(pair, subscription, 1)

            assert [one.payload for one in (*first, *take_all(pair, subscription, 1))] == [
                b"2",
                b"1",
            ]


def test_messages_of_another_thread_are_not_held(router: Bus) -> None:
    with paired("zenoh", router) as pair:
        subscription = pair.far.subscribe("r1/*", 10)
        publisher = pair.near.advertise("r1/odom", "")
        pair.wait(lambda: publisher.is_matched, "a subscriber")

        with pair.near.hold_messages():
            publisher.send(b"1")
            thread = threading.Thread(target=publisher.send, args=(b"2",))
            thread.start()
            thread.join()
            assert [one.payload for one in take_all(pair, subscription, 1)] == [b"2"]


def test_messages_of_expected_keys_arrive_at_every_subscription(router: Bus) -> None:
    with paired("zenoh", router) as pair:
        assert isinstance(pair.far, Bus)
        wide, exact = pair.far.subscribe("**/odom", 10), pair.far.subscribe("r1/odom", 10)
        publishers = [pair.near.advertise(f"r{number}/odom", "") for number in (1, 2)]
        pair.wait(lambda: all(one.is_matched for one in publishers), "subscribers")
        for _ in range(2):
            pair.far.expect_key("r1/odom")

        for one in publishers:
            one.send(b"1")
        late = pair.far.subscribe("*/odom", 10)
        take_all(pair, wide, 2)

        found: list[Sample] = []

        def is_late_one_there() -> bool:
            publishers[0].send(b"2")
            found.extend(late.take())
            return bool(found)

        pair.wait(is_late_one_there, "a message of a later subscription")
        assert [one.payload for one in take_all(pair, exact, 2)][:2] == [b"1", b"2"]
        late.close()


def test_arrivals_end_a_pause_and_differ_from_requests(router: Bus) -> None:
    with paired("zenoh", router) as pair:
        assert isinstance(pair.far, Bus)
        pair.far.watch_arrivals()
        arrivals = pair.far.arrivals
        assert arrivals is not None
        subscription, queue = pair.far.subscribe("r1/odom", 2), pair.far.serve("r1/get")
        publisher = pair.near.advertise("r1/odom", "application/cdr")
        pair.wait(lambda: publisher.is_matched, "a subscriber")
        for number in range(4):
            publisher.send(bytes([number]))
        arrivals.wait(WITHIN_S)

        assert not arrivals.take_requests()
        found: list[Sample] = []

        def is_newest_there() -> bool:
            found.extend(subscription.take())
            return bool(found) and found[-1].payload == b"\x03"

        pair.wait(is_newest_there, "the newest message")
        assert isinstance(pair.near, Bus)
        thread = threading.Thread(target=pair.near.get, args=("r1/get", WITHIN_S))
        thread.start()
        requests: list[Query] = []

        def is_requested() -> bool:
            arrivals.wait(0.1)
            if arrivals.take_requests():
                requests.extend(queue.take())
            return bool(requests)

        pair.wait(is_requested, "a request")
        requests[0].reply(b"1", "")
        thread.join()


def test_a_full_queue_keeps_the_newest(pair: Pair) -> None:
    shallow, deep = pair.far.subscribe("a", 2), pair.far.subscribe("a", 10)
    publisher = pair.near.advertise("a", "")
    pair.wait(lambda: publisher.is_matched, "a subscriber")

    for number in range(5):
        publisher.send(bytes([number]))
    take_all(pair, deep, 5)

    assert [sample.payload[0] for sample in shallow.take()] == [3, 4]


def test_newest_drops_what_is_older(pair: Pair) -> None:
    kept, all_of_them = pair.far.subscribe("a", 9), pair.far.subscribe("a", 9)
    publisher = pair.near.advertise("a", "")
    pair.wait(lambda: publisher.is_matched, "a subscriber")

    publisher.send(b"1")
    publisher.send(b"2")
    take_all(pair, all_of_them, 2)

    newest = kept.newest()
    assert newest is not None
    assert newest.payload == b"2"
    assert kept.take() == []


def test_a_publisher_is_matched_while_there_is_a_subscription(pair: Pair) -> None:
    publisher = pair.near.advertise("r1/odom", "")
    assert not publisher.is_matched

    one, other = pair.far.subscribe("r1/*"), pair.far.subscribe("r2/*")
    pair.wait(lambda: publisher.is_matched, "a subscriber")
    one.close()

    pair.wait(lambda: not publisher.is_matched, "no subscriber")
    other.close()


def test_a_closed_subscription_receives_nothing(pair: Pair) -> None:
    closed, kept = pair.far.subscribe("a", 9), pair.far.subscribe("a", 9)
    publisher = pair.near.advertise("a", "")
    pair.wait(lambda: publisher.is_matched, "a subscriber")

    closed.close()
    publisher.send(b"1")

    assert len(take_all(pair, kept, 1)) == 1


@pytest.mark.parametrize(
    ("reply", "expected"),
    [
        (lambda query: query.reply(b"x", "text/plain"), [("a/b", b"x", "text/plain", b"")]),
        (
            lambda query: query.reply(b"x", "text/plain", "a/b", b"more"),
            [("a/b", b"x", "text/plain", b"more")],
        ),
        (
            lambda query: query.reply_each([("a/b", b"1"), ("a/b", b"2")], "text/plain"),
            [("a/b", b"2", "text/plain", b"")],
        ),
        (lambda query: query.drop(), []),
    ],
    ids=["reply", "reply with attachment", "last of a key", "drop"],
)
def test_a_query_gets_the_replies(
    pair: Pair, reply: Callable[[Query], None], expected: list[tuple[str, bytes, str, bytes]]
) -> None:
    queue = pair.far.serve("a/*", 9)
    asked: list[tuple[str, str, bool, bool]] = []

    def serve() -> None:
        for query in queue.take():
            seen = (query.key, query.name, query.covers("a/b"), query.covers("a/c"))
            asked.append(seen)
            reply(query)

    found = query_until_served(pair, "a/b", serve, asked)

    assert asked == [("a/b", "b", True, False)]
    assert [(one.key, one.payload, one.encoding, one.attachment) for one in found] == expected


def test_a_query_of_several_values_ends_when_it_is_dropped(pair: Pair) -> None:
    queue = pair.far.serve("a/*", 9)
    asked: list[str] = []

    def serve() -> None:
        for query in queue.take():
            asked.append(query.key)
            for number in range(2):
                query.add_reply(f"a/{number}", b"x", "", b"", pair.far.stamp())
            query.drop()

    found = query_until_served(pair, "a/*", serve, asked)

    assert sorted(one.key for one in found) == ["a/0", "a/1"]


def test_a_closed_queue_gets_no_queries(pair: Pair) -> None:
    with closing(pair.far.serve("a", 9)):
        pass

    assert pair.query("a", lambda: None) == []


def serve_once(pair: Pair, response: DeleteEntityResponse | None) -> list[bytes]:
    """Serve every call in the background with a response, or drop it; return the request ids."""
    queue = pair.far.serve(keys.services("w"))
    seen: list[bytes] = []

    def serve() -> None:
        for call in queue.take():
            seen.append(call.request_id)
            if response is None:
                call.drop()
            else:
                call.reply(
                    encode(response, Format.MSGPACK), make_encoding(response, Format.MSGPACK)
                )

    if isinstance(pair.near, MemoryBus):
        pair.near.pumps.append(serve)
    else:
        threading.Thread(target=lambda: _repeat(serve, seen), daemon=True).start()
    return seen


def _repeat(serve: Callable[[], None], seen: list[bytes]) -> None:
    pause = threading.Event()
    while not seen:
        serve()
        pause.wait(0.001)


def call(pair: Pair, request_id: str = "") -> DeleteEntityResponse:
    assert isinstance(pair.near, Bus | MemoryBus)
    return pair.near.call(
        DELETE_ENTITY,
        DeleteEntityRequest("r1"),
        world="w",
        timeout_s=WITHIN_S,
        request_id=request_id,
    )


def call_until_served(pair: Pair, request_id: str = "") -> DeleteEntityResponse:
    """Call until the network knows the server: before, there is none."""

    def attempt() -> DeleteEntityResponse | None:
        with suppress(NoServer):
            return call(pair, request_id)
        return None

    return eventually(attempt, WITHIN_S, "a server")


def test_a_call_without_a_server_is_refused(pair: Pair) -> None:
    with pytest.raises(NoServer):
        call(pair)


def test_a_call_returns_the_response_and_has_its_id(pair: Pair) -> None:
    seen = serve_once(pair, DeleteEntityResponse(Result(ResultCode.OK)))

    assert call_until_served(pair, "again").result.result == ResultCode.OK
    assert seen == [b"again"]


def test_a_refused_call_raises_its_code(pair: Pair) -> None:
    serve_once(pair, DeleteEntityResponse(Result(ResultCode.NOT_FOUND, "no r1")))

    with pytest.raises(ServiceError, match="no r1") as refusal:
        call_until_served(pair)

    assert refusal.value.code == ResultCode.NOT_FOUND


def test_tokens_are_listed_and_watched(pair: Pair) -> None:
    near, far = pair.near, pair.far
    assert isinstance(near, Bus | MemoryBus)
    assert isinstance(far, Bus | MemoryBus)
    first = near.token("t/one")
    pair.wait(lambda: far.list_tokens("t/*") == ["t/one"], "the first token")
    watch = far.watch_tokens("t/*")
    changes: list[tuple[str, bool]] = []

    def has(*expected: tuple[str, bool]) -> Callable[[], bool]:
        def look() -> bool:
            changes.extend(watch.take())
            return changes == list(expected)

        return look

    pair.wait(has(("t/one", True)), "the present token")
    second = near.token("t/two")
    pair.wait(has(("t/one", True), ("t/two", True)), "the second token")
    first.close()
    pair.wait(has(("t/one", True), ("t/two", True), ("t/one", False)), "the end")
    second.close()
    watch.close()


chunks = st.sampled_from(("a", "b", "ab", "@a", "*", "**", "a$*", "$*b", "a$*b"))
expressions = st.lists(chunks, min_size=1, max_size=4).map("/".join)


@given(one=expressions, other=expressions)
def test_key_expressions_intersect_as_in_zenoh(one: str, other: str) -> None:
    one, other = (str(zenoh.KeyExpr.autocanonize(key)) for key in (one, other))

    assert intersect(one, other) == zenoh.KeyExpr(one).intersects(zenoh.KeyExpr(other))
