"""The Zenoh boundary: open, advertise, subscribe, serve, call. The only file that imports zenoh.

Everything arrives through channels that Zenoh's own threads fill and the caller drains, so that no
Python callback runs on a network thread and no open session can hang the interpreter's exit.
"""

import json
import time
import uuid
from collections.abc import Iterator
from typing import Final, Literal

import msgspec
import zenoh
from zenoh.handlers import FifoChannel, Handler, RingChannel

from proto import keys
from proto.catalog import Request, Response, Service
from proto.codec import Format, decode, encode, encoding_of
from proto.endpoint import DEFAULT_ENDPOINT, check_endpoint, with_free_port
from proto.result import Result, ResultCode, ServiceError
from proto.services import MAX_REQUEST_BYTES

MAX_MESSAGE_BYTES: Final = 16 * 1024 * 1024
RETRY_AFTER_S: Final = (0.01, 0.03, 0.1, 0.2, 0.0)
"""After a reconnect a query may end empty at first (zenoh#2767): ask again with the same id."""
TAKEN_BYTES: Final = 1 << 20
"""Of requests at once, so that who takes them can do something else in between."""
CALL_BYTES: Final = TAKEN_BYTES // 32
"""What a request counts for beside its payload."""
MAX_ANSWERS: Final = 16384
"""To one question, kept in a queue: a ring loses what is left in it when the last has come."""
NOTHING: Final = zenoh.ZBytes(b"")
LATEST: Final = 1
"""Subscription depth that keeps only the newest sample: for one publisher on one key."""


class BusError(Exception):
    """The network does not do what was asked."""


class Unreachable(BusError):
    """No router or server at the endpoints."""


class EndpointTaken(BusError):
    """Another process listens there."""


class NoServer(BusError):
    """A router is there, but nothing answers for this key."""


class BusConfig(msgspec.Struct, frozen=True, kw_only=True):
    """How to join the network; loopback, no scouting, no gossip unless told otherwise."""

    mode: Literal["client", "peer", "router"] = "client"
    connect: tuple[str, ...] = ()
    listen: tuple[str, ...] = ()
    lease_ms: int = 2000
    """A process that is stopped, not killed, is missed after about this long."""
    max_message_bytes: int = MAX_MESSAGE_BYTES
    open_timeout_s: float = 2.0


class Sample(msgspec.Struct, frozen=True):
    """One message as it came."""

    key: str
    payload: bytes
    encoding: str


class Publisher:
    """One key to put on. Never blocks: what a slow network cannot take is dropped."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher

    @property
    def is_matched(self) -> bool:
        """Whether anybody listens."""
        # The stub says bool; it is a MatchingStatus.
        return bool(self._publisher.matching_status.matching)  # type: ignore[attr-defined]

    def send(self, payload: bytes) -> None:
        """Put one message."""
        self._publisher.put(payload)

    def close(self) -> None:
        """Withdraw the publisher."""
        self._publisher.undeclare()


class Subscription:
    """Messages on a key expression; when nobody takes them the oldest are dropped."""

    def __init__(self, subscriber: "zenoh.Subscriber[Handler[zenoh.Sample]]") -> None:
        self._subscriber = subscriber

    def take(self) -> list[Sample]:
        """Take all that have come, oldest first."""
        return list(self._drain())

    def newest(self) -> Sample | None:
        """Take all and keep the last."""
        found = None
        for found in self._drain():  # noqa: B007  the last one is the result
            pass
        return found

    def close(self) -> None:
        """Stop listening."""
        self._subscriber.undeclare()

    def _drain(self) -> Iterator[Sample]:
        while (sample := self._subscriber.try_recv()) is not None:
            yield _sample(sample)


class Call:
    """A request that waits for its answer; reply once, or the caller gets nothing."""

    def __init__(self, query: zenoh.Query) -> None:
        self._query = query
        self.key = str(query.key_expr)
        payload = query.payload or NOTHING
        self.size = len(payload)
        # Of one that is too large nobody wants the copy.
        self.payload = payload.to_bytes() if self.size <= MAX_REQUEST_BYTES else b""
        self.encoding = str(query.encoding) if query.encoding else ""
        self.request_id = query.attachment.to_bytes() if query.attachment else b""

    @property
    def name(self) -> str:
        """The service asked for: the last chunk of the key."""
        return keys.last_chunk(self.key)

    def reply(self, payload: bytes, encoding: str, key: str = "") -> None:
        """Answer, and let the caller go; `key` when the request's is a pattern."""
        with self._query as query:
            query.reply(key or self.key, payload, encoding=encoding)

    def drop(self) -> None:
        """Let the caller go without an answer."""
        self._query.drop()


class CallQueue:
    """Requests on a key expression; when nobody takes them the oldest are let go unanswered."""

    def __init__(self, queryable: "zenoh.Queryable[Handler[zenoh.Query]]") -> None:
        self._queryable = queryable

    def take(self) -> list[Call]:
        """Take what has come, oldest first; of very much, the beginning."""
        calls: list[Call] = []
        room = TAKEN_BYTES
        while room > 0 and (query := self._queryable.try_recv()) is not None:
            calls.append(Call(query))
            room -= CALL_BYTES + len(calls[-1].payload)
        return calls

    def close(self) -> None:
        """Stop serving."""
        self._queryable.undeclare()


class Token:
    """Says that this process is alive, until closed or until the process is gone."""

    def __init__(self, token: zenoh.LivelinessToken) -> None:
        self._token = token

    def close(self) -> None:
        """Withdraw the token."""
        self._token.undeclare()


class TokenWatch:
    """Comings and goings of tokens."""

    def __init__(self, subscriber: "zenoh.Subscriber[Handler[zenoh.Sample]]") -> None:
        self._subscriber = subscriber

    def take(self) -> list[tuple[str, bool]]:
        """Take all changes: key, and whether it is alive."""
        changes = []
        while (sample := self._subscriber.try_recv()) is not None:
            changes.append((str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT))
        return changes

    def close(self) -> None:
        """Stop watching."""
        self._subscriber.undeclare()


class Bus:
    """One session on the network. Close it: use `with open_bus(...) as bus`."""

    def __init__(self, session: zenoh.Session, config: BusConfig) -> None:
        self._session = session
        self.config = config

    def __enter__(self) -> "Bus":
        """Return the bus itself."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the session."""
        self.close()

    @property
    def endpoint(self) -> str:
        """Where this bus listens, or else connects."""
        return (self.config.listen or self.config.connect or ("",))[0]

    def close(self) -> None:
        """End the session; tokens go, queues close."""
        self._session.close()

    def advertise(self, key: str, encoding: str) -> Publisher:
        """Declare a publisher whose payloads have this encoding."""
        declared = self._session.declare_publisher(
            _expression(key), encoding=encoding, congestion_control=zenoh.CongestionControl.DROP
        )
        return Publisher(declared)

    def subscribe(self, key: str, depth: int = LATEST) -> Subscription:
        """Listen to a key expression, keeping the newest `depth` messages in all."""
        return Subscription(self._session.declare_subscriber(_expression(key), RingChannel(depth)))

    def serve(self, key: str, depth: int = 4096) -> CallQueue:
        """Answer requests on a key expression."""
        return CallQueue(self._session.declare_queryable(key, RingChannel(depth), complete=True))

    def token(self, key: str) -> Token:
        """Declare this process alive under a key."""
        return Token(self._session.liveliness().declare_token(key))

    def watch_tokens(self, key: str, depth: int = 16384) -> TokenWatch:
        """Watch tokens, those that are up already first."""
        liveliness = self._session.liveliness()
        return TokenWatch(liveliness.declare_subscriber(key, RingChannel(depth), history=True))

    def alive(self, key: str, timeout_s: float = 1.0) -> list[str]:
        """List the tokens that are up now."""
        replies = self._session.liveliness().get(key, FifoChannel(MAX_ANSWERS), timeout=timeout_s)
        return [str(reply.ok.key_expr) for reply in replies if reply.ok]

    def get(self, key: str, timeout_s: float = 1.0, payload: bytes = b"") -> list[Sample]:
        """Ask a key expression for its values and collect the answers."""
        replies = self._session.get(
            _expression(key), FifoChannel(MAX_ANSWERS), payload=payload or None, timeout=timeout_s
        )
        return [_sample(reply.ok) for reply in replies if reply.ok]

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Response:
        """Call a service and return its response; the same `request_id` marks a retry.

        Raises:
            ServiceError: The server refused.
            TimeoutError: A server is there, but did not answer in time.
            NoServer: Nothing serves this world.
            MalformedPayload: The answer is not a response of this service.
        """
        payload = encode(request, Format.MSGPACK)
        if len(payload) > self.config.max_message_bytes:
            raise ServiceError(
                service.name,
                ResultCode.OPERATION_FAILED,
                "OPERATION_FAILED",
                f"request has {len(payload)} bytes; send at most {self.config.max_message_bytes}",
            )
        key = keys.service(world, service.name)
        encoding = encoding_of(request, Format.MSGPACK)
        answer = self._ask(key, payload, encoding, timeout_s, request_id or uuid.uuid4().hex)
        response = decode(service.response, answer.payload, answer.encoding)
        _raise_unless_ok(service, response)
        return response

    def _ask(
        self, key: str, payload: bytes, encoding: str, timeout_s: float, request_id: str
    ) -> Sample:
        for pause_s in RETRY_AFTER_S:
            for reply in self._session.get(
                key,
                FifoChannel(16),
                payload=payload,
                encoding=encoding,
                attachment=request_id,
                timeout=timeout_s,
            ):
                if reply.ok:
                    return _sample(reply.ok)
                raise TimeoutError(f"no answer from {key} within {timeout_s:g} s")
            time.sleep(pause_s)
        raise NoServer(f"nothing answers {key} at {self.endpoint}; start one with 'zensim serve'")


def open_bus(config: BusConfig) -> Bus:
    """Open a session.

    Raises:
        Unreachable: Nobody listens at the endpoints to connect to.
        EndpointTaken: The endpoint to listen at is in use.
        ValueError: An endpoint is not valid.
    """
    listen = tuple(with_free_port(endpoint) for endpoint in config.listen)
    connect = tuple(check_endpoint(endpoint) for endpoint in config.connect)
    if config.mode == "client" and not connect:
        connect = (DEFAULT_ENDPOINT,)
    settled = msgspec.structs.replace(config, listen=listen, connect=connect)
    try:
        return Bus(zenoh.open(_zenoh_config(settled)), settled)
    except zenoh.ZError as error:
        raise _open_error(settled, str(error)) from error


def settings_of(config: BusConfig) -> str:
    """Write a configuration as JSON, as Zenoh's own router takes it."""
    return str(_zenoh_config(config))


def _expression(key: str) -> zenoh.KeyExpr:
    try:
        canonical: zenoh.KeyExpr = zenoh.KeyExpr.autocanonize(key)
    except zenoh.ZError as error:
        raise ValueError(f"key {key[:80]!r} is not valid; use names joined by '/'") from error
    return canonical


def _zenoh_config(config: BusConfig) -> zenoh.Config:
    entries = {
        "mode": config.mode,
        "listen/endpoints": list(config.listen),
        "connect/endpoints": list(config.connect),
        "connect/timeout_ms": round(config.open_timeout_s * 1000),
        "connect/exit_on_failure": True,
        "connect/retry": {"period_init_ms": 100, "period_max_ms": 500},
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "scouting/delay": 0,
        # Its pools cost every process 20 MB.
        "transport/shared_memory/enabled": False,
        "transport/link/tx/lease": config.lease_ms,
        "transport/link/rx/max_message_size": config.max_message_bytes,
    }
    made: zenoh.Config = zenoh.Config()
    for path, value in entries.items():
        made.insert_json5(path, json.dumps(value))
    return made


def _open_error(config: BusConfig, text: str) -> BusError:
    if "in use" in text:
        return EndpointTaken(
            f"{config.listen[0]} is taken by another process; stop it, use --listen with another "
            "port, or --connect to it"
        )
    if "listener" in text:
        reason = text.partition(" at /")[0]
        return BusError(f"cannot listen at {', '.join(config.listen)}: {reason}")
    where = ", ".join(config.connect)
    return Unreachable(f"nobody listens at {where}; start one with 'zensim serve' or use --connect")


def _sample(sample: zenoh.Sample) -> Sample:
    return Sample(str(sample.key_expr), sample.payload.to_bytes(), str(sample.encoding))


def _raise_unless_ok(service: Service[Request, Response], response: Response) -> None:
    result: Result = getattr(response, "result", Result())
    if result.result != ResultCode.OK:
        name = service.code_name(result.result)
        raise ServiceError(service.name, result.result, name, result.error_message, response)
