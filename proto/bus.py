"""The Zenoh boundary: open, advertise, subscribe, serve, call. One door with `channels`.

Everything arrives through channels that Zenoh's own threads fill and the caller drains, so that no
Python callback runs on a network thread and no open session can hang the interpreter's exit.
"""

import json
import time
import uuid
from typing import Final, Literal

import msgspec
import zenoh
from zenoh.handlers import FifoChannel, RingChannel

from zensim.proto import keys
from zensim.proto.catalog import Request, Response, Service
from zensim.proto.channels import (
    Call,
    CallQueue,
    Publisher,
    Sample,
    Stamp,
    Subscription,
    Token,
    TokenWatch,
    sample_of,
)
from zensim.proto.codec import Format, decode, encode, encoding_of
from zensim.proto.endpoint import DEFAULT_ENDPOINT, check_endpoint, with_free_port
from zensim.proto.result import Result, ResultCode, ServiceError

__all__ = [
    "LATEST",
    "MAX_MESSAGE_BYTES",
    "Bus",
    "BusConfig",
    "BusError",
    "Call",
    "CallQueue",
    "EndpointTaken",
    "NoServer",
    "Publisher",
    "Sample",
    "Stamp",
    "Subscription",
    "Token",
    "TokenWatch",
    "Unreachable",
    "open_bus",
    "settings_of",
]

MAX_MESSAGE_BYTES: Final = 16 * 1024 * 1024
RETRY_AFTER_S: Final = (0.01, 0.03, 0.1, 0.2, 0.0)
"""After a reconnect a query may end empty at first (zenoh#2767): ask again with the same id."""
MAX_ANSWERS: Final = 16384
"""To one question, kept in a queue: a ring loses what is left in it when the last has come."""
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

    @property
    def zid(self) -> str:
        """The session's own id, in hexadecimal digits."""
        return str(self._session.info.zid())

    def stamp(self) -> Stamp:
        """Make a stamp of now."""
        return self._session.new_timestamp()

    def beside(self) -> "Bus":
        """Open another session to the same network; close it too.

        Raises:
            BusError: As `open_bus` does.
        """
        at = self.config.listen if self.config.mode == "router" else self.config.connect
        return open_bus(msgspec.structs.replace(self.config, mode="client", connect=at, listen=()))

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

    def serve(self, key: str, depth: int = 4096, *, is_complete: bool = True) -> CallQueue:
        """Answer requests on a key expression.

        Args:
            key: What may be asked for.
            depth: How many requests may wait.
            is_complete: Nobody else has a part of the answer; otherwise all who serve are asked.
        """
        declared = self._session.declare_queryable(
            _expression(key), RingChannel(depth), complete=is_complete
        )
        return CallQueue(declared)

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
        return [sample_of(reply.ok) for reply in replies if reply.ok]

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
                    return sample_of(reply.ok)
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


def _raise_unless_ok(service: Service[Request, Response], response: Response) -> None:
    result: Result = getattr(response, "result", Result())
    if result.result != ResultCode.OK:
        name = service.code_name(result.result)
        raise ServiceError(service.name, result.result, name, result.error_message, response)
