"""What a bus hands out: publishers, subscriptions, requests, tokens. One door with `proto.bus`."""

from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import TYPE_CHECKING, Final, TypeAlias, TypeVar

import msgspec
import zenoh
from zenoh.handlers import RingChannel

from zensim.proto import keys
from zensim.proto.codec import decode
from zensim.proto.services import MAX_REQUEST_BYTES

if TYPE_CHECKING:
    from zenoh.handlers import Handler

Message = TypeVar("Message", bound=msgspec.Struct)

TAKEN_BYTES: Final = 1 << 20
"""Of requests at once, so that who takes them can do something else in between."""
CALL_BYTES: Final = TAKEN_BYTES // 32
"""What a request counts for beside its payload."""
Stamp: TypeAlias = zenoh.Timestamp
"""When a sample was made, by the clock of its session."""
NOTHING: Final = zenoh.ZBytes(b"")


class Sample(msgspec.Struct, frozen=True):
    """One message as it came."""

    key: str
    payload: bytes
    encoding: str
    attachment: bytes = b""


class Publisher:
    """One key to put on. Never blocks: what a slow network cannot take is dropped."""

    def __init__(self, publisher: zenoh.Publisher) -> None:
        self._publisher = publisher
        self._put = publisher.put
        self._changes: zenoh.MatchingListener[Handler[zenoh.MatchingStatus]] | None = None
        self._was_matched = False

    @property
    def is_matched(self) -> bool:
        """Whether anybody listens."""
        if self._changes is None:
            # To ask each time costs ten times as much as to be told of changes.
            self._changes = self._publisher.declare_matching_listener(RingChannel(1))
            # The stub says bool; it is a MatchingStatus.
            self._was_matched = self._publisher.matching_status.matching  # type: ignore[attr-defined]
        while (change := self._changes.try_recv()) is not None:
            self._was_matched = change.matching
        return self._was_matched

    def send(self, payload: bytes, attachment: bytes = b"", stamp: Stamp | None = None) -> None:
        """Put one message; who hears two of one stamp takes them for one."""
        # Each argument costs as much as a tenth of the put.
        if stamp is not None:
            self._put(payload, attachment=attachment or None, timestamp=stamp)
        elif attachment:
            self._put(payload, attachment=attachment)
        else:
            self._put(payload)

    def close(self) -> None:
        """Withdraw the publisher."""
        if self._changes is not None:
            self._changes.undeclare()
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
            yield sample_of(sample)


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

    def read(self, kind: type[Message]) -> Message:
        """Decode the request.

        Raises:
            MalformedPayload: The bytes are not that message.
        """
        return decode(kind, self.payload, self.encoding)

    def covers(self, key: str) -> bool:
        """Whether this asks for that key, perhaps among others."""
        return bool(zenoh.KeyExpr(self.key).intersects(key))

    def reply(self, payload: bytes, encoding: str, key: str = "", attachment: bytes = b"") -> None:
        """Answer, and let the caller go; `key` when the request's is a pattern."""
        with self._query as query:
            query.reply(key or self.key, payload, encoding=encoding, attachment=attachment or None)

    def reply_each(self, answers: Iterable[tuple[str, bytes]], encoding: str) -> None:
        """Answer with many values, each on a key of its own, and let the caller go."""
        with self._query as query:
            for key, payload in answers:
                query.reply(key, payload, encoding=encoding)

    def add_reply(
        self, key: str, payload: bytes, encoding: str, attachment: bytes, stamp: Stamp
    ) -> None:
        """Answer with one sample of several; `drop` ends the answer.

        A caller who does not take samples of that key gets none.
        """
        with suppress(zenoh.ZError):
            self._query.reply(
                key, payload, encoding=encoding, attachment=attachment, timestamp=stamp
            )

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


def sample_of(sample: zenoh.Sample) -> Sample:
    """Take over what came."""
    attachment = sample.attachment
    return Sample(
        str(sample.key_expr),
        sample.payload.to_bytes(),
        str(sample.encoding),
        attachment.to_bytes() if attachment else b"",
    )
