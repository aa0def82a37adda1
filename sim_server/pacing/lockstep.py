"""Lockstep: which agents have not replied to the newest drive state. No clock, no network."""

from dataclasses import dataclass
from typing import Literal

from zensim.proto.messages.agent_messages import DriveCommand, DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS

OnMiss = Literal["wait", "hold", "fail"]
LOCKSTEP_TIMEOUT_S = 1.0
MAX_CHECK_INTERVAL_NS = 20_000_000
"""Most waiting time counted per check: the server itself may have been stopped."""


@dataclass(frozen=True)
class LockstepSettings:
    """Waiting for agents at control steps.

    Attributes:
        is_on: Wait for the agents at each control step; without it only at requested steps.
        timeout_s: Wall time that an agent has for its command.
        on_miss: Then `wait` until its token disappears, `hold` the old targets and continue, or
            `fail`: pause and abort the requested steps.
    """

    is_on: bool = False
    timeout_s: float = LOCKSTEP_TIMEOUT_S
    on_miss: OnMiss = "hold"


@dataclass
class _SentState:
    """Last state published to an agent, and whether its reply is awaited."""

    epoch: int
    step: int
    claims: bytes
    is_awaited: bool
    waited_ns: int = 0

    def matches(self, command: DriveCommand) -> bool:
        return (command.epoch, command.step, command.claims) == (self.epoch, self.step, self.claims)


class Lockstep:
    """Replies that the agents of one world owe."""

    def __init__(self, settings: LockstepSettings | None = None) -> None:
        self.settings = settings or LockstepSettings()
        self._sent: dict[str, _SentState] = {}
        self._awaited: set[str] = set()
        self._misses: dict[str, int] = {}
        self._unresponsive: set[str] = set()
        self._last_check_ns = 0

    @property
    def awaited(self) -> tuple[str, ...]:
        """Agents whose reply is awaited."""
        return tuple(sorted(self._awaited))

    @property
    def is_waiting(self) -> bool:
        """Whether any reply is awaited."""
        return bool(self._awaited)

    @property
    def misses(self) -> dict[str, int]:
        """Number of late or missing replies, by agent."""
        return dict(self._misses)

    def has_sent(self, agent: str, state: DriveState) -> bool:
        """Whether the agent has been sent a state with these claims in this epoch."""
        sent = self._sent.get(agent)
        return sent is not None and (sent.epoch, sent.claims) == (state.epoch, state.claims)

    def record_sent(self, agent: str, state: DriveState, now_ns: int) -> bool:
        """Record a published state; replies to older ones are not awaited any more.

        Returns:
            False if the agent was late before, so that its reply is not awaited.
        """
        if not self._awaited:
            self._last_check_ns = now_ns
        self._awaited.discard(agent)
        self._sent[agent] = _SentState(state.epoch, state.step, state.claims, state.is_awaited)
        if not state.is_awaited:
            return True
        if self.settings.on_miss == "hold" and agent in self._unresponsive:
            self._misses[agent] += 1
            return False
        self._awaited.add(agent)
        return True

    def record_answer(self, agent: str, command: DriveCommand) -> bool:
        """Record a command; return whether it may be applied.

        While a reply is awaited, commands for older states are not applied.
        """
        self._unresponsive.discard(agent)
        if (sent := self._sent.get(agent)) is None:
            return True
        if not sent.matches(command):
            return not sent.is_awaited
        self._awaited.discard(agent)
        return True

    def find_late(self, now_ns: int) -> tuple[str, ...]:
        """Advance wall time; list the agents whose timeout has just ended.

        With `wait` their replies stay awaited, with a new timeout.
        """
        passed_ns = min(now_ns - self._last_check_ns, MAX_CHECK_INTERVAL_NS)
        self._last_check_ns = now_ns
        for agent in self._awaited:
            self._sent[agent].waited_ns += passed_ns
        late = tuple(agent for agent in self.awaited if self._is_late(agent))
        for agent in late:
            self._sent[agent].waited_ns = 0
            if self.settings.on_miss != "wait":
                self._record_miss(agent)
        return late

    def forget(self, agent: str) -> None:
        """Await nothing from an agent that has disappeared or drives nothing any more."""
        self._sent.pop(agent, None)
        self._misses.pop(agent, None)
        self._awaited.discard(agent)
        self._unresponsive.discard(agent)

    def _is_late(self, agent: str) -> bool:
        return self._sent[agent].waited_ns >= self.settings.timeout_s * NANOSECONDS

    def _record_miss(self, agent: str) -> None:
        self._misses[agent] = self._misses.get(agent, 0) + 1
        self._unresponsive.add(agent)
        self._awaited.discard(agent)
