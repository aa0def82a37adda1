"""A bus in memory for the live server: publications, tokens and models, and what is subscribed."""

from collections import deque
from typing import Any, cast

import msgspec

from zensim.proto import keys
from zensim.proto.bus.bus_session import Bus
from zensim.proto.messages.entity_messages import EntityState, GetEntitiesStatesResponse
from zensim.proto.messages.telemetry_messages import GetModelsResponse
from zensim.proto.network_protocols import Sample
from zensim.proto.service_catalog import GET_ENTITIES_STATES, GET_MODELS, Service


class FakeSubscription:
    """Queue of a key expression."""

    def __init__(self, bus: "FakeBus", key: str, depth: int) -> None:
        self.key = key
        self.queue: deque[Sample] = deque(maxlen=depth)
        self._bus = bus

    def take(self) -> list[Sample]:
        found = [*self.queue]
        self.queue.clear()
        return found

    def take_payloads(self) -> list[bytes]:
        return [one.payload for one in self.take()]

    def newest(self) -> Sample | None:
        found = self.take()
        return found[-1] if found else None

    def close(self) -> None:
        self._bus.subscriptions.remove(self)


class FakeTokens:
    """Changes of liveliness tokens."""

    def __init__(self) -> None:
        self.changes: list[tuple[str, bool]] = []

    def take(self) -> list[tuple[str, bool]]:
        found, self.changes = self.changes, []
        return found

    def close(self) -> None:
        self.changes = []


class FakePublisher:
    """Keeps what is sent."""

    def __init__(self, sent: list[tuple[str, bytes]], key: str) -> None:
        self._sent, self._key = sent, key

    def send(self, payload: bytes) -> None:
        self._sent.append((self._key, payload))

    def close(self) -> None:
        self._sent.append((self._key, b"closed"))


class FakeBus:
    """A session without a network."""

    user = ""

    def __init__(self) -> None:
        self.subscriptions: list[FakeSubscription] = []
        self.sent: list[tuple[str, bytes]] = []
        self.stored: list[Sample] = []
        self.models = GetModelsResponse()
        self.states: dict[str, EntityState] = {}

    @property
    def as_bus(self) -> Bus:
        return cast("Bus", self)

    @property
    def keys(self) -> set[str]:
        """What is subscribed."""
        return {one.key for one in self.subscriptions}

    def subscribe(self, key: str, depth: int = 1) -> FakeSubscription:
        self.subscriptions.append(FakeSubscription(self, key, depth))
        return self.subscriptions[-1]

    def watch_tokens(self, _key: str, _depth: int = 0) -> FakeTokens:
        return FakeTokens()

    def advertise(self, key: str, _encoding: str) -> FakePublisher:
        return FakePublisher(self.sent, key)

    def publish(self, key: str, payload: bytes, encoding: str = "") -> None:
        """Deliver a message to those who have subscribed."""
        for one in self.subscriptions:
            if keys.intersect(one.key, key):
                one.queue.append(Sample(key, payload, encoding))

    def get(self, key: str, _timeout_s: float = 0.0) -> list[Sample]:
        return [one for one in self.stored if keys.intersect(key, one.key)]

    get_all = get

    def call(
        self, service: Service[Any, Any], _request: msgspec.Struct, **_: object
    ) -> GetModelsResponse | GetEntitiesStatesResponse:
        if service is GET_ENTITIES_STATES:
            return GetEntitiesStatesResponse(
                entities=tuple(self.states), states=tuple(self.states.values())
            )
        assert service is GET_MODELS
        return self.models
