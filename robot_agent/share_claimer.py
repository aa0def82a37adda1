"""Asks for a pool's share of all robots: when it starts, when shares may change, now and then."""

import logging
import math

import msgspec

from zensim.proto import keys
from zensim.proto.bus import NoServer
from zensim.proto.codec.message_codec import MalformedPayload, decode
from zensim.proto.messages.agent_messages import Claim, ClaimShareRequest, OnRelease, expand_grants
from zensim.proto.messages.result_messages import ResultCode, ServiceError
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.service_catalog import CLAIM_SHARE
from zensim.robot_agent.giving_up import give_up
from zensim.robot_agent.network import Network

LOG = logging.getLogger("zensim.agent")
CALL_TIMEOUT_S = 5.0
SOONEST_S = 0.05
"""Between two requests, however many events there are."""
LATEST_S = 1.0
"""Events may be lost, and a pool that died says nothing of its limit."""
EVENTS_DEPTH = 1024
"""That something has happened is enough to know."""
CHANGES = frozenset({"spawned", "deleted", "released", "loaded"})


class ShareWish(msgspec.Struct, frozen=True, kw_only=True):
    """Which share a pool asks for, and how long it waits for a server when it starts."""

    world: str
    agent: str
    limit: int
    """Most robots that it drives; 0 = any number."""
    on_release: OnRelease
    wait_s: float


class ShareClaimer:
    """Knows when to ask for more."""

    def __init__(self, network: Network, wish: ShareWish) -> None:
        self._network = network
        self._wish = wish
        self._events = network.subscribe(keys.events(wish.world), EVENTS_DEPTH)
        self._has_asked = False
        self._give_up_s: float | None = None
        self._asked_s = self._next_s = -math.inf
        self._retry_s = SOONEST_S
        self._reason = ""

    def want(self, entities: tuple[str, ...]) -> None:
        """Do nothing: robots that went to another pool are its own now."""

    def hurry(self) -> None:
        """Ask soon: something has changed."""
        self._next_s = min(self._next_s, self._asked_s + SOONEST_S)

    def poll(self, now_s: float) -> tuple[Claim, ...]:
        """Ask for what is missing of the share, if it is time to.

        Raises:
            ServiceError: Refused, at the first time and for good.
            NoServer: Nothing served this world for as long as was to be waited.
            TimeoutError: The server does not answer.
            MalformedPayload: The answer is none.
        """
        if self._has_news():
            self.hurry()
        if now_s < self._next_s:
            return ()
        if self._give_up_s is None:
            self._give_up_s = now_s + self._wish.wait_s
        self._asked_s, self._next_s = now_s, now_s + LATEST_S
        try:
            return self._ask()
        except (ServiceError, NoServer, TimeoutError, MalformedPayload) as error:
            self._put_off(error, now_s)
        return ()

    def _has_news(self) -> bool:
        has_news = False
        for sample in self._events.take():
            try:
                event = decode(Event, sample.payload, sample.encoding)
            except MalformedPayload:
                continue
            has_news = has_news or event.kind in CHANGES
        return has_news

    def _ask(self) -> tuple[Claim, ...]:
        wish = self._wish
        request = ClaimShareRequest(wish.agent, wish.limit, wish.on_release)
        response = self._network.call(
            CLAIM_SHARE, request, world=wish.world, timeout_s=CALL_TIMEOUT_S
        )
        self._has_asked, self._reason, self._retry_s = True, "", SOONEST_S
        if response.is_more:
            self._next_s = -math.inf
        return expand_grants(response)

    def _put_off(self, error: Exception, now_s: float) -> None:
        is_passing = isinstance(error, NoServer | TimeoutError) or (
            # The server has not seen the token yet.
            isinstance(error, ServiceError) and error.code == ResultCode.INCORRECT_STATE
        )
        is_over = self._give_up_s is not None and now_s >= self._give_up_s
        if not self._has_asked and (is_over or not is_passing):
            give_up(error, self._wish.wait_s)
        if str(error) != self._reason:
            self._reason = str(error)
            LOG.info("waiting agent=%s reason=%r", self._wish.agent, self._reason)
        self._next_s = now_s + self._retry_s
        self._retry_s = min(2.0 * self._retry_s, LATEST_S)
