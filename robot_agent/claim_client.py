"""Clients of claim_entity and claim_share: request, retry with back-off, and react to events."""

import logging
import math
from typing import NoReturn

import msgspec

from zensim.proto.bus import NoServer
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.agent_messages import (
    Claim,
    ClaimEntityRequest,
    ClaimShareRequest,
    OnRelease,
    expand_grants,
)
from zensim.proto.messages.result_messages import ClaimCode, ResultCode, ServiceError
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.network_protocols import AgentNetwork, Subscription
from zensim.proto.service_catalog import CLAIM_ENTITY, CLAIM_SHARE
from zensim.proto.topic_catalog import EVENTS


def raise_with_wait(error: Exception, wait_s: float) -> NoReturn:
    """Raise an error again, with the time that was waited [s] in its text.

    Raises:
        ServiceError: When the error is one; else one of the error's own class.
    """
    waited = f" (waited {wait_s:.1f} s)" if wait_s else ""
    if isinstance(error, ServiceError):
        text = f"{error.message}{waited}"
        raise ServiceError(error.service, error.code, error.code_name, text) from error
    raise type(error)(f"{error}{waited}") from error


LOG = logging.getLogger("zensim.agent")
CALL_TIMEOUT_S = 5.0
MIN_CALL_TIMEOUT_S = 0.5
MIN_RETRY_S = 0.05
MAX_RETRY_S = 1.0
CLAIM_EVENTS_DEPTH = 256
TRANSIENT_CODES = frozenset(
    {
        int(ResultCode.NOT_FOUND),  # it is spawned later
        int(ResultCode.INCORRECT_STATE),  # the server has not seen the token yet
        int(ClaimCode.ALREADY_CLAIMED),  # the agent that has it is dying
    }
)
"""Refusals that may end by themselves."""


class ClaimSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Which entities an agent wants, and how long it waits for them when it starts."""

    world: str
    agent: str
    entities: tuple[str, ...]
    on_release: OnRelease
    wait_s: float


class NamedClaimClient:
    """Knows what is missing, and when to ask for it next."""

    def __init__(self, network: AgentNetwork, wish: ClaimSettings) -> None:
        self._network = network
        self._settings = wish
        self._missing = wish.entities
        self._has_claimed = self._is_split = False
        self._give_up_s: float | None = None
        self._retry_s, self._next_s = MIN_RETRY_S, -math.inf
        self._reason = ""
        self._events: Subscription | None = None

    def reclaim(self, entities: tuple[str, ...]) -> None:
        """Ask at once for entities that were lost."""
        self._missing += entities
        self.retry_soon()

    def retry_soon(self) -> None:
        """Ask at once: something has changed."""
        self._retry_s, self._next_s = MIN_RETRY_S, -math.inf

    def poll(self, now_s: float) -> tuple[Claim, ...]:
        """Ask for what is missing, if it is time to.

        Raises:
            ServiceError: Refused, and nothing was claimed since the start: for good, or for as
                long as was to be waited. The same for the others.
            NoServer: Nothing serves this world.
            TimeoutError: The server does not answer.
            MalformedPayload: The answer is none.
        """
        if not self._missing:
            return ()
        self._take_events()
        if now_s < self._next_s:
            return ()
        if self._give_up_s is None:
            self._give_up_s = now_s + self._settings.wait_s
        claims = self._claim(now_s)
        self._note_granted(claims)
        return claims

    def _take_events(self) -> None:
        if self._events is None:
            key = EVENTS.key(self._settings.world)
            self._events = self._network.subscribe(key, CLAIM_EVENTS_DEPTH)
        for sample in self._events.take():
            try:
                event = decode(Event, sample.payload, sample.encoding)
            except MalformedPayload:
                continue
            if event.entity in self._missing and event.kind in ("spawned", "released"):
                self.retry_soon()

    def _claim(self, now_s: float) -> tuple[Claim, ...]:
        granted: list[Claim] = []
        groups = [(one,) for one in self._missing] if self._is_split else [self._missing]
        for group in groups:
            claims = self._try_claim(group, now_s)
            if claims is None:
                break
            granted += claims
        return tuple(granted)

    def _try_claim(self, entities: tuple[str, ...], now_s: float) -> tuple[Claim, ...] | None:
        """Ask once; none when refused, None when nobody is there to ask."""
        try:
            return self._call(entities, now_s)
        except ServiceError as error:
            self._schedule_retry(error, now_s, is_passing=error.code in TRANSIENT_CODES)
        except MalformedPayload as error:
            self._schedule_retry(error, now_s, is_passing=False)
        except (NoServer, TimeoutError) as error:
            self._schedule_retry(error, now_s, is_passing=True)
            return None
        return ()

    def _call(self, entities: tuple[str, ...], now_s: float) -> tuple[Claim, ...]:
        wish, timeout_s = self._settings, CALL_TIMEOUT_S
        if self._give_up_s is not None and not self._has_claimed:
            timeout_s = min(timeout_s, max(MIN_CALL_TIMEOUT_S, self._give_up_s - now_s))
        request = ClaimEntityRequest(wish.agent, entities, wish.on_release)
        response = self._network.call(CLAIM_ENTITY, request, world=wish.world, timeout_s=timeout_s)
        return expand_grants(response)

    def _schedule_retry(self, error: Exception, now_s: float, *, is_passing: bool) -> None:
        is_over = self._give_up_s is not None and now_s >= self._give_up_s
        if not self._has_claimed and (is_over or not is_passing):
            raise_with_wait(error, self._settings.wait_s)
        if self._has_claimed and isinstance(error, ServiceError):
            # Of several, those that are there need not wait for those that are not.
            self._is_split = True
        if str(error) != self._reason:
            self._reason = str(error)
            LOG.info("waiting agent=%s reason=%r", self._settings.agent, self._reason)
        self._next_s = now_s + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, MAX_RETRY_S)

    def _note_granted(self, claims: tuple[Claim, ...]) -> None:
        granted = {claim.entity for claim in claims}
        self._missing = tuple(name for name in self._missing if name not in granted)
        if granted:
            self._has_claimed = True
            self._reason = ""
        if self._missing or self._events is None:
            return
        self._is_split = False
        self._events.close()
        self._events = None


MIN_SHARE_PERIOD_S = 0.05
"""Between two requests, however many events there are."""
MAX_SHARE_PERIOD_S = 1.0
"""Events may be lost, and a pool that died says nothing of its limit."""
SHARE_EVENTS_DEPTH = 1024
"""That something has happened is enough to know."""
SHARE_EVENTS = frozenset({"spawned", "deleted", "released", "loaded"})


class ShareSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Which share a pool asks for, and how long it waits for a server when it starts."""

    world: str
    agent: str
    limit: int
    """Most robots that it drives; 0 = any number."""
    on_release: OnRelease
    wait_s: float


class ShareClaimClient:
    """Knows when to ask for more."""

    def __init__(self, network: AgentNetwork, wish: ShareSettings) -> None:
        self._network = network
        self._settings = wish
        self._events = network.subscribe(EVENTS.key(wish.world), SHARE_EVENTS_DEPTH)
        self._has_asked = False
        self._give_up_s: float | None = None
        self._asked_s = self._next_s = -math.inf
        self._retry_s = MIN_SHARE_PERIOD_S
        self._reason = ""

    def reclaim(self, entities: tuple[str, ...]) -> None:
        """Do nothing: robots that went to another pool are its own now."""

    def retry_soon(self) -> None:
        """Ask soon: something has changed."""
        self._next_s = min(self._next_s, self._asked_s + MIN_SHARE_PERIOD_S)

    def poll(self, now_s: float) -> tuple[Claim, ...]:
        """Ask for what is missing of the share, if it is time to.

        Raises:
            ServiceError: Refused, at the first time and for good.
            NoServer: Nothing served this world for as long as was to be waited.
            TimeoutError: The server does not answer.
            MalformedPayload: The answer is none.
        """
        if self._has_relevant_event():
            self.retry_soon()
        if now_s < self._next_s:
            return ()
        if self._give_up_s is None:
            self._give_up_s = now_s + self._settings.wait_s
        self._asked_s, self._next_s = now_s, now_s + MAX_SHARE_PERIOD_S
        try:
            return self._claim()
        except (ServiceError, NoServer, TimeoutError, MalformedPayload) as error:
            self._schedule_retry(error, now_s)
        return ()

    def _has_relevant_event(self) -> bool:
        has_news = False
        for sample in self._events.take():
            try:
                event = decode(Event, sample.payload, sample.encoding)
            except MalformedPayload:
                continue
            has_news = has_news or event.kind in SHARE_EVENTS
        return has_news

    def _claim(self) -> tuple[Claim, ...]:
        wish = self._settings
        request = ClaimShareRequest(wish.agent, wish.limit, wish.on_release)
        response = self._network.call(
            CLAIM_SHARE, request, world=wish.world, timeout_s=CALL_TIMEOUT_S
        )
        self._has_asked, self._reason, self._retry_s = True, "", MIN_SHARE_PERIOD_S
        if response.is_more:
            self._next_s = -math.inf
        return expand_grants(response)

    def _schedule_retry(self, error: Exception, now_s: float) -> None:
        is_passing = isinstance(error, NoServer | TimeoutError) or (
            # The server has not seen the token yet.
            isinstance(error, ServiceError) and error.code == ResultCode.INCORRECT_STATE
        )
        is_over = self._give_up_s is not None and now_s >= self._give_up_s
        if not self._has_asked and (is_over or not is_passing):
            raise_with_wait(error, self._settings.wait_s)
        if str(error) != self._reason:
            self._reason = str(error)
            LOG.info("waiting agent=%s reason=%r", self._settings.agent, self._reason)
        self._next_s = now_s + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, MAX_SHARE_PERIOD_S)
