"""Lockstep: which clients have not replied to the newest state. No clock, no network.

A client is an agent, which replies to drive states with commands, or a sensor process, which
replies to scene states.
"""

from dataclasses import dataclass
from typing import Protocol

from zensim.proto.messages.standard_messages import NANOSECONDS
from zensim.proto.settings.lockstep_settings import LockstepSettings

MAX_CHECK_INTERVAL_NS = 20_000_000
"""Most waiting time counted per check: the server itself may have been stopped."""


class StateReply(Protocol):
    """A reply, which repeats what it replies to."""

    @property
    def epoch(self) -> int:
        """Number of the epoch."""

    @property
    def step(self) -> int:
        """Step since the epoch began."""

    @property
    def claims(self) -> bytes:
        """Claims of the agent to which the state was published; empty for other clients."""

    @property
    def order(self) -> int:
        """Number of the last order of twists in the agent's state; 0 for other clients."""


class AwaitedState(StateReply, Protocol):
    """A state that was published to a client."""

    @property
    def is_awaited(self) -> bool:
        """Whether the loop waits for the reply."""


@dataclass
class _SentState:
    """Last state published to a client, and whether its reply is awaited."""

    epoch: int
    step: int
    claims: bytes
    order: int
    is_awaited: bool
    waited_ns: int = 0

    def matches(self, reply: StateReply) -> bool:
        own = self.epoch, self.step, self.claims, self.order
        return (reply.epoch, reply.step, reply.claims, reply.order) == own


SentStates = tuple[tuple[str, tuple[int, int, bytes, int]], ...]
"""Epoch, step, claims and order of the last state of each client."""


class Lockstep:
    """Replies that the agents and sensor processes of one world owe, by name."""

    def __init__(self, settings: LockstepSettings | None = None) -> None:
        self.settings = settings or LockstepSettings()
        self._sent: dict[str, _SentState] = {}
        self._awaited: set[str] = set()
        self._unanswered: set[str] = set()
        """Agents with a last state whose reply is neither awaited nor here."""
        self._misses: dict[str, int] = {}
        self._unresponsive: set[str] = set()
        self._last_check_ns = 0

    @property
    def rule(self) -> str:
        """What happens when a client is late, for the log."""
        return f"on_miss={self.settings.on_miss}"

    @property
    def _goes_on(self) -> bool:
        return self.settings.on_miss == "hold"

    @property
    def has_timeout(self) -> bool:
        """Whether a client that is late is given up, so that time goes on or ends."""
        return self.settings.on_miss != "wait"

    @property
    def ends_when_late(self) -> bool:
        """Whether a client that is late pauses the world."""
        return self.settings.on_miss == "fail"

    @property
    def awaited(self) -> tuple[str, ...]:
        """Clients whose reply is awaited."""
        return tuple(sorted(self._awaited))

    @property
    def unanswered(self) -> frozenset[str]:
        """Agents that have not replied to their last state, for which nothing has waited."""
        return frozenset(self._unanswered)

    @property
    def is_waiting(self) -> bool:
        """Whether any reply is awaited."""
        return bool(self._awaited)

    @property
    def misses(self) -> dict[str, int]:
        """Number of late or missing replies, by client."""
        return dict(self._misses)

    def has_sent(self, agent: str, state: AwaitedState) -> bool:
        """Whether the agent has been sent a state with these claims in this epoch."""
        sent = self._sent.get(agent)
        return sent is not None and (sent.epoch, sent.claims) == (state.epoch, state.claims)

    def record_sent(self, client: str, state: AwaitedState, now_ns: int) -> bool:
        """Record a published state; replies to older ones are not awaited any more.

        Returns:
            False if the client was late before, so that its reply is not awaited.
        """
        if not self._awaited:
            self._last_check_ns = now_ns
        self._awaited.discard(client)
        self._unanswered.discard(client)
        self._sent[client] = _SentState(
            state.epoch, state.step, state.claims, state.order, state.is_awaited
        )
        if not state.is_awaited:
            if state.claims:
                self._unanswered.add(client)
            return True
        if self._goes_on and client in self._unresponsive:
            self._misses[client] += 1
            return False
        self._awaited.add(client)
        return True

    def record_answer(self, client: str, reply: StateReply) -> bool:
        """Record a reply; return whether it may be applied.

        While a reply is awaited, those to older states are not applied.
        """
        self._unresponsive.discard(client)
        if (sent := self._sent.get(client)) is None:
            return True
        if not sent.matches(reply):
            return not sent.is_awaited
        self._awaited.discard(client)
        self._unanswered.discard(client)
        return True

    def save(self) -> SentStates:
        """Take the last states of a world in which nobody is awaited."""
        return tuple(
            (client, (sent.epoch, sent.step, sent.claims, sent.order))
            for client, sent in self._sent.items()
        )

    def load(self, saved: SentStates) -> None:
        """Replace what `save` took."""
        self._sent = {client: _SentState(*state, is_awaited=False) for client, state in saved}
        self._awaited.clear()
        self._unanswered.clear()

    def find_late(self, now_ns: int) -> tuple[str, ...]:
        """Advance wall time; list the clients whose timeout has just ended.

        With `wait` their replies stay awaited, with a new timeout.
        """
        passed_ns = min(now_ns - self._last_check_ns, MAX_CHECK_INTERVAL_NS)
        self._last_check_ns = now_ns
        for client in self._awaited:
            self._sent[client].waited_ns += passed_ns
        late = tuple(client for client in self.awaited if self._is_late(client))
        for client in late:
            self._sent[client].waited_ns = 0
            if self.has_timeout:
                self._record_miss(client)
        return late

    def forget(self, client: str) -> None:
        """Await nothing from a client that has gone, or from an agent that drives nothing."""
        self._sent.pop(client, None)
        self._misses.pop(client, None)
        self._awaited.discard(client)
        self._unanswered.discard(client)
        self._unresponsive.discard(client)

    def _is_late(self, client: str) -> bool:
        return self._sent[client].waited_ns >= self.settings.lockstep_timeout * NANOSECONDS

    def _record_miss(self, client: str) -> None:
        self._misses[client] = self._misses.get(client, 0) + 1
        self._unresponsive.add(client)
        self._awaited.discard(client)
