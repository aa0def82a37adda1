"""Asks for entities until it has them: again and again, and at once when something has changed."""

import logging
import math

import msgspec

from zensim.proto import keys
from zensim.proto.bus import NoServer
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.agent_messages import Claim, ClaimEntityRequest, OnRelease, expand_grants
from zensim.proto.messages.result_messages import ClaimCode, ResultCode, ServiceError
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.service_catalog import CLAIM_ENTITY
from zensim.robot_agent.giving_up import give_up
from zensim.robot_agent.network import Network, Subscription

LOG = logging.getLogger("zensim.agent")
CALL_TIMEOUT_S = 5.0
SHORTEST_CALL_S = 0.5
FIRST_RETRY_S = 0.05
LAST_RETRY_S = 1.0
EVENTS_DEPTH = 256
PASSING = frozenset(
    {
        int(ResultCode.NOT_FOUND),  # it is spawned later
        int(ResultCode.INCORRECT_STATE),  # the server has not seen the token yet
        int(ClaimCode.ALREADY_CLAIMED),  # the agent that has it is dying
    }
)
"""Refusals that may end by themselves."""


class Wish(msgspec.Struct, frozen=True, kw_only=True):
    """Which entities an agent wants, and how long it waits for them when it starts."""

    world: str
    agent: str
    entities: tuple[str, ...]
    on_release: OnRelease
    wait_s: float


class Claimer:
    """Knows what is missing, and when to ask for it next."""

    def __init__(self, network: Network, wish: Wish) -> None:
        self._network = network
        self._wish = wish
        self._missing = wish.entities
        self._has_claimed = self._is_split = False
        self._give_up_s: float | None = None
        self._retry_s, self._next_s = FIRST_RETRY_S, -math.inf
        self._reason = ""
        self._events: Subscription | None = None

    def want(self, entities: tuple[str, ...]) -> None:
        """Ask at once for entities that were lost."""
        self._missing += entities
        self.hurry()

    def hurry(self) -> None:
        """Ask at once: something has changed."""
        self._retry_s, self._next_s = FIRST_RETRY_S, -math.inf

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
        self._hear()
        if now_s < self._next_s:
            return ()
        if self._give_up_s is None:
            self._give_up_s = now_s + self._wish.wait_s
        claims = self._ask(now_s)
        self._count_in(claims)
        return claims

    def _hear(self) -> None:
        if self._events is None:
            key = keys.events(self._wish.world)
            self._events = self._network.subscribe(key, EVENTS_DEPTH)
        for sample in self._events.take():
            try:
                event = decode(Event, sample.payload, sample.encoding)
            except MalformedPayload:
                continue
            if event.entity in self._missing and event.kind in ("spawned", "released"):
                self.hurry()

    def _ask(self, now_s: float) -> tuple[Claim, ...]:
        granted: list[Claim] = []
        groups = [(one,) for one in self._missing] if self._is_split else [self._missing]
        for group in groups:
            claims = self._try(group, now_s)
            if claims is None:
                break
            granted += claims
        return tuple(granted)

    def _try(self, entities: tuple[str, ...], now_s: float) -> tuple[Claim, ...] | None:
        """Ask once; none when refused, None when nobody is there to ask."""
        try:
            return self._call(entities, now_s)
        except ServiceError as error:
            self._put_off(error, now_s, is_passing=error.code in PASSING)
        except MalformedPayload as error:
            self._put_off(error, now_s, is_passing=False)
        except (NoServer, TimeoutError) as error:
            self._put_off(error, now_s, is_passing=True)
            return None
        return ()

    def _call(self, entities: tuple[str, ...], now_s: float) -> tuple[Claim, ...]:
        wish, timeout_s = self._wish, CALL_TIMEOUT_S
        if self._give_up_s is not None and not self._has_claimed:
            timeout_s = min(timeout_s, max(SHORTEST_CALL_S, self._give_up_s - now_s))
        request = ClaimEntityRequest(wish.agent, entities, wish.on_release)
        response = self._network.call(CLAIM_ENTITY, request, world=wish.world, timeout_s=timeout_s)
        return expand_grants(response)

    def _put_off(self, error: Exception, now_s: float, *, is_passing: bool) -> None:
        is_over = self._give_up_s is not None and now_s >= self._give_up_s
        if not self._has_claimed and (is_over or not is_passing):
            give_up(error, self._wish.wait_s)
        if self._has_claimed and isinstance(error, ServiceError):
            # Of several, those that are there need not wait for those that are not.
            self._is_split = True
        if str(error) != self._reason:
            self._reason = str(error)
            LOG.info("waiting agent=%s reason=%r", self._wish.agent, self._reason)
        self._next_s = now_s + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, LAST_RETRY_S)

    def _count_in(self, claims: tuple[Claim, ...]) -> None:
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
