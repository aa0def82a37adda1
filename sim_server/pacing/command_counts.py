"""Drive commands taken of each agent against those due: one for each step whose state it got.

A command is due when it comes, or else when the next state is sent: what is still on its way at the
end of a second is not missing.
"""

from dataclasses import dataclass

from zensim.proto.messages.telemetry_messages import AgentCommands

Step = tuple[int, int]
"""Epoch and step."""
NO_STEP: Step = (-1, -1)


@dataclass
class _CommandCount:
    """Counts of one agent; `due_before` and `taken_before` are those at the begin of the window."""

    due: int = 0
    taken: int = 0
    due_before: int = 0
    taken_before: int = 0
    due_hz: float = 0.0
    taken_hz: float = 0.0
    last_sent: Step = NO_STEP
    is_awaited: bool = False
    """Whether the command for the last step sent is not due yet."""
    last_taken: Step = NO_STEP


class CommandCounts:
    """Counts by agent since it came, and rates over windows of wall time.

    The real-time factor stays at its target while a starved agent answers one state of twenty.
    """

    def __init__(self) -> None:
        self.due = self.taken = 0
        """Counts of all agents since the start."""
        self.least_share = 1.0
        """Least share of the commands due that an agent sent in the last window, at most 1."""
        self._agents: dict[str, _CommandCount] = {}

    def note_sent(self, agent: str, step: Step) -> None:
        """Note a state that an agent gets; the same step again counts once."""
        count = self._agents.setdefault(agent, _CommandCount())
        if count.last_sent != step:
            self._end_wait(count)
            count.last_sent, count.is_awaited = step, True

    def _end_wait(self, count: _CommandCount) -> None:
        """Count the command for the last step sent as due."""
        count.due += count.is_awaited
        self.due += count.is_awaited
        count.is_awaited = False

    def note_taken(self, agent: str, step: Step) -> None:
        """Count a command that was taken; a second one for a step does not count."""
        count = self._agents.setdefault(agent, _CommandCount())
        if count.last_taken != step:
            count.last_taken = step
            count.taken += 1
            self.taken += 1
        if count.last_sent == step:
            self._end_wait(count)

    def forget(self, agent: str) -> None:
        """Forget an agent that is gone."""
        self._agents.pop(agent, None)

    def close_window(self, elapsed_s: float) -> None:
        """Compute the rates since the last call, `elapsed_s` ago."""
        shares = [1.0]
        for count in self._agents.values():
            due, taken = count.due - count.due_before, count.taken - count.taken_before
            count.due_before, count.taken_before = count.due, count.taken
            count.due_hz, count.taken_hz = due / elapsed_s, taken / elapsed_s
            if due:
                shares.append(taken / due)
        self.least_share = min(shares)

    def list_agents(self) -> dict[str, AgentCommands]:
        """List the counts and the rates of the last window, by agent."""
        return {
            agent: AgentCommands(one.taken, one.due, one.taken_hz, one.due_hz)
            for agent, one in self._agents.items()
        }
