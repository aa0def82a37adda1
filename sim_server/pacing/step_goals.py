"""Queue of requested steps, with progress, cancellation and results."""

from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from zensim.proto.messages.simulation_messages import StepsGoalStatus, StepsProgress
from zensim.proto.messages.standard_messages import NANOSECONDS

PROGRESS_HZ = 10
MAX_FINISHED_GOALS = 256
"""Goals that are over and whose results can still be fetched."""


@dataclass
class StepGoal:
    """So many steps; a reset sets time back, not what is left.

    Attributes:
        goal_id: Empty when nobody is to hear of its progress.
        late: Agents that did not answer all of its control steps in time.
        reason: Why it was aborted.
    """

    steps: int
    goal_id: str = ""
    completed: int = 0
    status: StepsGoalStatus = "executing"
    late: set[str] = field(default_factory=set)
    reason: str = ""
    progress_sent_ns: int | None = None
    """Wall time when its progress was told last."""

    @property
    def remaining(self) -> int:
        """Steps that are not made yet."""
        return self.steps - self.completed

    @property
    def is_over(self) -> bool:
        """Whether nothing more will be done for it."""
        return self.status != "executing"

    @property
    def progress(self) -> StepsProgress:
        """How far it is."""
        return StepsProgress(self.goal_id, self.completed, self.remaining, self.status)


class StepGoals:
    """The goals that are not over yet, and the last of those that are."""

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
        """Ask for steps behind those asked for before."""
        goal = StepGoal(steps, goal_id)
        self._goals.append(goal)
        if goal_id:
            self._known[goal_id] = goal
            self._forget_oldest()
        return goal

    def find(self, goal_id: str) -> StepGoal | None:
        """Find a goal by its id, also one that is over."""
        return self._known.get(goal_id)

    def note_step(self) -> None:
        """Count a step for the first goal."""
        self._goals[0].completed += 1

    def note_late(self, agents: Iterable[str]) -> None:
        """Remember which agents the steps of the first goal went on without."""
        if self._goals:
            self._goals[0].late.update(agents)

    def finish_completed(self) -> None:
        """End the goals that have made all their steps; call it when no agent is awaited."""
        while self._goals and self._goals[0].remaining <= 0:
            self._end(self._goals[0], "succeeded")

    def cancel(self, goal_id: str) -> list[StepGoal]:
        """End a goal before its last step, or without an id all goals; return those ended."""
        canceled = [goal for goal in self._goals if goal_id in ("", goal.goal_id)]
        for goal in canceled:
            self._end(goal, "canceled")
        return canceled

    def abort(self, reason: str) -> None:
        """End all goals: they cannot be reached."""
        for goal in self._goals[:]:
            self.abort_goal(goal, reason)

    def abort_goal(self, goal: StepGoal, reason: str) -> None:
        """End a goal, unless it is over."""
        if not goal.is_over:
            goal.reason = reason
            self._end(goal, "aborted")

    def due_progress(self, now_ns: int) -> Iterator[StepsProgress]:
        """Tell how far goals with an id are: the first of them now and then, those ended at once.

        Args:
            now_ns: Wall time.
        """
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
