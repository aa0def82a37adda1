"""Clients of claim_entity and claim_share: call, retry with back-off, and react to events."""

import logging
import math
import uuid
from collections.abc import Callable
from contextlib import suppress
from typing import NoReturn

import msgspec

from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.codec.message_codec import MalformedPayload
from zensim.proto.messages.agent_messages import (
    Claim,
    ClaimEntityRequest,
    ClaimShareRequest,
    ClaimShareResponse,
    OnRelease,
    expand_grants,
)
from zensim.proto.messages.result_messages import ClaimCode, ResultCode, ServiceError
from zensim.proto.messages.telemetry_messages import PROTOCOL, Event
from zensim.proto.near_names import name_choices
from zensim.proto.network_protocols import AgentNetwork, PendingCall
from zensim.proto.service_catalog import CLAIM_ENTITY, CLAIM_SHARE
from zensim.proto.topic_catalog import EVENTS
from zensim.spawner.client.service_client import ServiceClient
from zensim.spawner.client.topic_reader import TopicReader, read_topic

LOG = logging.getLogger("zensim.agent")
CALL_TIMEOUT_S = 5.0
MIN_CALL_TIMEOUT_S = 0.5
MIN_RETRY_S, MAX_RETRY_S = 0.05, 1.0
"""Pauses between calls that fail; each doubles the pause."""
CLAIM_EVENTS_DEPTH = 256
TRANSIENT_CODES = frozenset(
    {
        int(ResultCode.NOT_FOUND),  # it may be spawned later
        int(ResultCode.INCORRECT_STATE),  # the server has not received the agent's token yet
        int(ClaimCode.ALREADY_CLAIMED),  # its agent may be about to end
    }
)
"""Refusals of claim_entity that are worth a retry."""
MIN_SHARE_PERIOD_S = 0.05
"""Least time between two calls, however many events there are."""
MAX_SHARE_PERIOD_S = 1.0
"""Calls are repeated, as events may be lost, and none says that a pool with a limit ended."""
CLAIM_EVENTS = frozenset({"spawned", "released", "timed_out"})
SHARE_EVENTS_DEPTH = 1024
"""Lost events do no harm: one is enough for a call."""
SHARE_EVENTS = frozenset({"spawned", "deleted", "released", "timed_out", "loaded"})


def raise_with_wait(error: Exception, wait_s: float) -> NoReturn:
    """Raise an error again, with the time that was waited [s] in its text.

    Raises:
        ServiceError: If the error is one; else one of the error's class.
    """
    waited = f" (waited {wait_s:.1f} s)" if wait_s else ""
    if isinstance(error, ServiceError):
        text = f"{error.message}{waited}"
        raise ServiceError(error.service, error.code, error.code_name, text) from error
    raise type(error)(f"{error}{waited}") from error


class ClaimRetry:
    """Back-off of calls that fail, and the deadline of the first success."""

    def __init__(
        self, agent: str, wait_s: float, describe: Callable[[Exception], str] = str
    ) -> None:
        self.has_succeeded = False
        self._agent = agent
        self._describe = describe
        self._wait_s = wait_s
        self._give_up_s: float | None = None
        self._pause_s = MIN_RETRY_S
        self._reason = ""

    def start(self, now_s: float) -> None:
        """Start the deadline, once."""
        if self._give_up_s is None:
            self._give_up_s = now_s + self._wait_s

    def find_timeout_s(self, now_s: float) -> float:
        """Find the timeout of a call [s]; the deadline shortens it."""
        if self.has_succeeded or self._give_up_s is None:
            return CALL_TIMEOUT_S
        return min(CALL_TIMEOUT_S, max(MIN_CALL_TIMEOUT_S, self._give_up_s - now_s))

    def reset_pause(self) -> None:
        """Start the back-off again."""
        self._pause_s = MIN_RETRY_S

    def note_success(self) -> None:
        """Note a success; from now on there is no deadline."""
        self.has_succeeded, self._reason = True, ""

    def note_failure(self, error: Exception, now_s: float, *, is_transient: bool) -> float:
        """Log a failure once; return the time of the next call [s].

        Raises:
            ServiceError: There was no success yet, and the failure is final or the deadline is
                over; else one of the error's class.
        """
        is_over = self._give_up_s is not None and now_s >= self._give_up_s
        if not self.has_succeeded and (is_over or not is_transient):
            left_s = 0.0 if self._give_up_s is None else max(0.0, self._give_up_s - now_s)
            raise_with_wait(error, self._wait_s - left_s)
        if str(error) != self._reason:
            self._reason = str(error)
            LOG.info("waiting agent=%s reason=%r", self._agent, self._describe(error))
        next_s = now_s + self._pause_s
        self._pause_s = min(2.0 * self._pause_s, MAX_RETRY_S)
        return next_s


class ClaimSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Entities that an agent claims, and how long it waits for them at the start."""

    world: str
    agent: str
    entities: tuple[str, ...]
    on_release: OnRelease
    wait_s: float


class NamedClaimClient:
    """Claims entities by name, and again if they were lost."""

    def __init__(self, network: AgentNetwork, settings: ClaimSettings) -> None:
        self._network = network
        self._settings = settings
        self._missing = settings.entities
        self._is_split = False
        self._retry = ClaimRetry(settings.agent, settings.wait_s, self._describe)
        self._next_s = -math.inf
        self._events: TopicReader[Event] | None = None

    def reclaim(self, entities: tuple[str, ...]) -> None:
        """Claim lost entities at the next poll."""
        self._missing += entities
        self.retry_soon()

    def retry_soon(self) -> None:
        """Call at the next poll: something has changed."""
        self._retry.reset_pause()
        self._next_s = -math.inf

    def forget_call(self) -> None:
        """Do nothing: no call is pending between two polls."""

    def poll(self, now_s: float) -> tuple[Claim, ...]:
        """Claim missing entities, if it is time.

        Raises:
            ServiceError: Nothing was claimed yet, and the refusal is final or the deadline is over.
                Likewise the others.
            NoServer: No server has this world.
            TimeoutError: The server does not reply.
            MalformedPayload: The reply is malformed.
        """
        if not self._missing:
            return ()
        self._react_to_events()
        if now_s < self._next_s:
            return ()
        self._retry.start(now_s)
        claims = self._claim(now_s)
        self._note_granted(claims)
        return claims

    def _describe(self, error: Exception) -> str:
        """Describe why the agent waits; for a name that nothing has, what there is instead."""
        if not isinstance(error, ServiceError) or error.code != ResultCode.NOT_FOUND:
            return str(error)
        world, timeout_s = self._settings.world, MIN_CALL_TIMEOUT_S
        with suppress(ServiceError, NoServer, TimeoutError, MalformedPayload):
            known = ServiceClient(self._network, world, timeout_s).entities()
            absent = [one for one in self._missing if one not in known]
            choices = name_choices(absent[0], known) if absent else ""
            return f"{' and '.join(absent)} not spawned yet; there are {choices or 'none'}"
        return str(error)

    def _react_to_events(self) -> None:
        if self._events is None:
            key = EVENTS.key(self._settings.world)
            self._events = read_topic(self._network, key, Event, CLAIM_EVENTS_DEPTH)
        for event in self._events.take():
            if event.entity in self._missing and event.kind in CLAIM_EVENTS:
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
        """Call once; empty if refused, None if there is no server."""
        try:
            return self._call(entities, now_s)
        except ServiceError as error:
            is_transient = error.code in TRANSIENT_CODES
            self._next_s = self._retry.note_failure(error, now_s, is_transient=is_transient)
            # Entities that exist do not wait for those that do not.
            self._is_split = self._is_split or self._retry.has_succeeded
        except MalformedPayload as error:
            self._next_s = self._retry.note_failure(error, now_s, is_transient=False)
        except (NoServer, TimeoutError) as error:
            self._next_s = self._retry.note_failure(error, now_s, is_transient=True)
            return None
        return ()

    def _call(self, entities: tuple[str, ...], now_s: float) -> tuple[Claim, ...]:
        settings, timeout_s = self._settings, self._retry.find_timeout_s(now_s)
        request = ClaimEntityRequest(
            settings.agent, entities, settings.on_release, protocol=PROTOCOL
        )
        response = self._network.call(
            CLAIM_ENTITY, request, world=settings.world, timeout_s=timeout_s
        )
        return expand_grants(response)

    def _note_granted(self, claims: tuple[Claim, ...]) -> None:
        granted = {claim.entity for claim in claims}
        self._missing = tuple(name for name in self._missing if name not in granted)
        if granted:
            self._retry.note_success()
        if self._missing or self._events is None:
            return
        self._is_split = False
        self._events.close()
        self._events = None


class ShareSettings(msgspec.Struct, frozen=True, kw_only=True):
    """Share that a pool claims, and how long it waits for a server at the start."""

    world: str
    agent: str
    limit: int
    """Maximum number of robots; 0 = any."""
    on_release: OnRelease
    wait_s: float


class ShareClaimClient:
    """Claims an even share of all robots, again and again.

    The reply is awaited beside driving: a call among 10,000 robots may take a second.
    """

    def __init__(self, network: AgentNetwork, settings: ShareSettings) -> None:
        self._network = network
        self._settings = settings
        key = EVENTS.key(settings.world)
        self._events = read_topic(network, key, Event, SHARE_EVENTS_DEPTH)
        self._retry = ClaimRetry(settings.agent, settings.wait_s)
        self._called_s = self._next_s = -math.inf
        self._call: PendingCall[ClaimShareResponse] | None = None
        self._request_id = _make_request_id()

    def reclaim(self, entities: tuple[str, ...]) -> None:
        """Do nothing: robots that went to another pool belong to it."""

    def retry_soon(self) -> None:
        """Call soon: something has changed."""
        self._next_s = min(self._next_s, self._called_s + MIN_SHARE_PERIOD_S)

    def forget_call(self) -> None:
        """Forget the call that is pending: its server is gone, and the claims with it."""
        self._end_request()

    def poll(self, now_s: float) -> tuple[Claim, ...]:
        """Claim what is missing of the share, if it is time; return what a reply has granted.

        Raises:
            ServiceError: The first call was refused, and the refusal is final.
            NoServer: No server had this world until the deadline.
            TimeoutError: The server does not reply.
            MalformedPayload: The reply is malformed.
        """
        if any(event.kind in SHARE_EVENTS for event in self._events.take()):
            self.retry_soon()
        if self._call is None and now_s < self._next_s:
            return ()
        try:
            if self._call is None:
                self._begin(now_s)
            return self._take_reply()
        except (NoServer, TimeoutError) as error:
            # The server may have granted claims: the same request gets that reply.
            self._call = None
            self._next_s = self._retry.note_failure(error, now_s, is_transient=True)
        except (ServiceError, MalformedPayload) as error:
            self._end_request()
            # The server has not received the agent's token yet.
            is_early = isinstance(error, ServiceError) and error.code == ResultCode.INCORRECT_STATE
            self._next_s = self._retry.note_failure(error, now_s, is_transient=is_early)
        return ()

    def _end_request(self) -> None:
        self._call, self._request_id = None, _make_request_id()

    def _begin(self, now_s: float) -> None:
        self._retry.start(now_s)
        self._called_s, self._next_s = now_s, now_s + MAX_SHARE_PERIOD_S
        settings = self._settings
        request = ClaimShareRequest(settings.agent, settings.limit, settings.on_release, PROTOCOL)
        self._call = self._network.begin_call(
            CLAIM_SHARE,
            request,
            world=settings.world,
            timeout_s=CALL_TIMEOUT_S,
            request_id=self._request_id,
        )

    def _take_reply(self) -> tuple[Claim, ...]:
        response = None if self._call is None else self._call.poll()
        if response is None:
            return ()
        self._end_request()
        self._retry.note_success()
        self._retry.reset_pause()
        if response.is_more:
            self._next_s = -math.inf
        return expand_grants(response)


def _make_request_id() -> str:
    return uuid.uuid4().hex
