"""Lockstep: which agents have not answered the newest drive state. No clock, no network."""

from dataclasses import dataclass
from typing import Literal

from zensim.proto.messages.agent_messages import DriveCommand, DriveState
from zensim.proto.messages.standard_messages import NANOSECONDS

OnMiss = Literal["wait", "hold", "fail"]
LOCKSTEP_TIMEOUT_S = 1.0
MAX_CHECK_INTERVAL_NS = 20_000_000
"""Most that one look counts as waiting: a server that was stopped itself has not waited."""


@dataclass(frozen=True)
class LockstepSettings:
    """What to do at control steps.

    Attributes:
        is_on: Wait for the agents at each control step; without it only at requested steps.
        timeout_s: Wall time that an agent has for its answer.
        on_miss: After that: `wait` on until its token goes, `hold` the old targets and go on, or
            `fail`: stand still and say so.
    """

    is_on: bool = False
    timeout_s: float = LOCKSTEP_TIMEOUT_S
    on_miss: OnMiss = "hold"


@dataclass
class _SentState:
    """What an agent was told last, and whether time waits for its answer."""

    epoch: int
    step: int
    claims: bytes
    is_awaited: bool
    waited_ns: int = 0

    def matches(self, command: DriveCommand) -> bool:
        return (command.epoch, command.step, command.claims) == (self.epoch, self.step, self.claims)


class Lockstep:
    """Keeps the books of one world's agents."""

    def __init__(self, settings: LockstepSettings | None = None) -> None:
        self.settings = settings or LockstepSettings()
        self._sent: dict[str, _SentState] = {}
        self._awaited: set[str] = set()
        self._misses: dict[str, int] = {}
        self._unresponsive: set[str] = set()
        self._last_check_ns = 0

    @property
    def awaited(self) -> tuple[str, ...]:
        """Agents that owe an answer."""
        return tuple(sorted(self._awaited))

    @property
    def is_waiting(self) -> bool:
        """Whether any agent owes an answer."""
        return bool(self._awaited)

    @property
    def misses(self) -> dict[str, int]:
        """States that were not answered in time, by agent."""
        return dict(self._misses)

    def has_sent(self, agent: str, state: DriveState) -> bool:
        """Whether an agent knows what it drives, in this epoch."""
        told = self._sent.get(agent)
        return told is not None and (told.epoch, told.claims) == (state.epoch, state.claims)

    def record_sent(self, agent: str, state: DriveState, now_ns: int) -> bool:
        """Note that an agent is told a state; answers to older ones are owed no more.

        Returns:
            False when its answer should be awaited, but the agent has been silent too long for it.
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
        """Take note of a command; tell whether it may be carried out.

        A state that is awaited has one answer: a command for another one is not carried out.
        """
        self._unresponsive.discard(agent)
        if (told := self._sent.get(agent)) is None:
            return True
        if not told.matches(command):
            return not told.is_awaited
        self._awaited.discard(agent)
        return True

    def find_late(self, now_ns: int) -> tuple[str, ...]:
        """Let wall time pass; name the agents whose time for an answer has just run out.

        With `wait` they go on owing it, and their time begins anew.
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
        """Owe nothing: the agent has gone, or drives nothing any more."""
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
