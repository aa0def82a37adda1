"""The run of a world to a time, of which there is one at a time for all visitors of a page."""


class RunActive(Exception):
    """A world runs to a time already."""

    def __init__(self, *, is_own: bool, goal_s: float) -> None:
        """Say whose run it is."""
        who = "this page" if is_own else "another visitor"
        super().__init__(f"{who} runs the world to {goal_s:g} s; wait for it, or press Cancel run")


class WorldRun:
    """Which visitor has begun the run that is active, and to which time.

    Attributes:
        visitor: None = there is no run.
        goal_s: Simulation time at which it ends.
    """

    def __init__(self) -> None:
        """Have no run."""
        self.visitor: int | None = None
        self.goal_s = 0.0
        self._number = 0

    def begin(self, visitor: int, goal_s: float) -> int:
        """Begin a run, and return its number.

        Raises:
            RunActive: There is one.
        """
        if self.visitor is not None:
            raise RunActive(is_own=self.visitor == visitor, goal_s=self.goal_s)
        self.visitor, self.goal_s = visitor, goal_s
        self._number += 1
        return self._number

    def end(self, number: int) -> None:
        """End the run with this number; without effect after another one has begun."""
        if number == self._number:
            self.visitor = None

    def cancel(self) -> None:
        """End the run that is active."""
        self.end(self._number)
