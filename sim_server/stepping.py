"""Steps that were asked for: made one after another, in the order of asking."""

from dataclasses import dataclass


@dataclass
class Goal:
    """So many steps; a reset sets time back, not what is left."""

    left: int
    made: int = 0

    @property
    def is_reached(self) -> bool:
        """Whether all steps are made."""
        return self.left == 0


class Stepping:
    """The goals that are not reached yet."""

    def __init__(self) -> None:
        self._goals: list[Goal] = []

    def __bool__(self) -> bool:
        return bool(self._goals)

    def add(self, steps: int) -> Goal:
        """Ask for steps behind those asked for before."""
        goal = Goal(steps)
        self._goals.append(goal)
        return goal

    def note_step(self) -> None:
        """Count a step for the first goal."""
        first = self._goals[0]
        first.left -= 1
        first.made += 1
        if first.is_reached:
            self._goals.pop(0)
