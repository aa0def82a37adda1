"""Queue of requested steps, with progress, cancellation and results."""

from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from zensim.proto.messages.simulation_messages import StepsGoalStatus, StepsProgress
from zensim.proto.messages.standard_messages import NANOSECONDS

PROGRESS_HZ = 10
MAX_FINISHED_GOALS = 256
"""Ended goals whose results can still be fetched."""


@dataclass
class StepGoal:
    """A number of requested steps; a reset does not change how many remain.

    Attributes:
        goal_id: Empty if no progress is published.
        late: Agents that did not reply to all of its control steps in time.
        reason: Why the goal was aborted.
    """

    steps: int
    goal_id: str = ""
    completed: int = 0
    status: StepsGoalStatus = "executing"
    late: set[str] = field(default_factory=set)
    reason: str = ""
    is_eager: bool = False
    """Whether it ends with its last step, before the agents have answered it."""
    progress_sent_ns: int | None = None
    """Wall time of the last progress message."""

    @property
    def remaining(self) -> int:
        """Steps still to be made."""
        return self.steps - self.completed

    @property
    def is_over(self) -> bool:
        """Whether the goal has ended."""
        return self.status != "executing"

    @property
    def progress(self) -> StepsProgress:
        """Progress message of the goal."""
        return StepsProgress(self.goal_id, self.completed, self.remaining, self.status)


class StepGoals:
    """Queue of active goals, and the newest ended ones."""

    def __init__(self) -> None:
        self._goals: list[StepGoal] = []
        self._ended: list[StepGoal] = []
        self._known: OrderedDict[str, StepGoal] = OrderedDict()

    def __len__(self) -> int:
        return len(self._goals)

    @property
    def has_steps_left(self) -> bool:
        """Whether the first goal has steps left to make."""
        return bool(self._goals) and self._goals[0].remaining > 0

    def add(self, steps: int, goal_id: str = "") -> StepGoal:
        """Append a goal to the queue."""
        goal = StepGoal(steps, goal_id)
        self._goals.append(goal)
        if goal_id:
            self._known[goal_id] = goal
            self._forget_oldest()
        return goal

    def find(self, goal_id: str) -> StepGoal | None:
        """Find an active or ended goal by its id."""
        return self._known.get(goal_id)

    @property
    def ends_eagerly(self) -> bool:
        """Whether the steps of the first goal are made, and it does not wait for the agents."""
        return bool(self._goals) and self._goals[0].is_eager and self._goals[0].remaining <= 0

    def note_step(self) -> None:
        """Count a step for the first goal."""
        self._goals[0].completed += 1

    def note_late(self, agents: Iterable[str]) -> None:
        """Note agents that were late in a step of the first goal."""
        if self._goals:
            self._goals[0].late.update(agents)

    def finish_completed(self) -> None:
        """End the goals whose steps are made; call it when no agent is awaited."""
        while self._goals and self._goals[0].remaining <= 0:
            self._end(self._goals[0], "succeeded")

    def cancel(self, goal_id: str) -> list[StepGoal]:
        """Cancel the goal with an id, or all if it is empty; return those canceled."""
        canceled = [goal for goal in self._goals if goal_id in ("", goal.goal_id)]
        for goal in canceled:
            self._end(goal, "canceled")
        return canceled

    def abort(self, reason: str) -> None:
        """Abort all active goals."""
        for goal in self._goals[:]:
            self.abort_goal(goal, reason)

    def abort_goal(self, goal: StepGoal, reason: str) -> None:
        """Abort a goal if it is active."""
        if not goal.is_over:
            goal.reason = reason
            self._end(goal, "aborted")

    def due_progress(self, now_ns: int) -> Iterator[StepsProgress]:
        """Make the progress messages due at a wall time: at 10 Hz, and when a goal ends."""
        ended, self._ended = self._ended, []
        yield from (goal.progress for goal in ended if goal.goal_id)
        first = self._goals[0] if self._goals else None
        if first is None or not first.goal_id:
            return
        if (
            first.progress_sent_ns is None
            or now_ns - first.progress_sent_ns >= NANOSECONDS // PROGRESS_HZ
        ):
            first.progress_sent_ns = now_ns
            yield first.progress

    def _end(self, goal: StepGoal, status: StepsGoalStatus) -> None:
        goal.status = status
        self._goals.remove(goal)
        self._ended.append(goal)

    def _forget_oldest(self) -> None:
        over = [name for name, goal in self._known.items() if goal.is_over]
        for name in over[: max(0, len(self._known) - MAX_FINISHED_GOALS)]:
            del self._known[name]
