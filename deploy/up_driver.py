"""UpDriver: what drives the robots of `zensim up` while the command waits for its end."""

from abc import abstractmethod
from collections.abc import Callable

from zensim.api.closed_on_exit import ClosedOnExit


class UpDriver(ClosedOnExit):
    """Drives robots in a world that runs by itself; `update` has to be called often."""

    @abstractmethod
    def update(self) -> None:
        """Do what is due."""

    def ends_the_run(self) -> bool:
        """Whether the command ends, because nothing follows."""
        return False

    def watch(self, should_stop: Callable[[], bool]) -> Callable[[], bool]:
        """Update whenever a loop checks whether to stop."""

        def update_and_check() -> bool:
            self.update()
            return self.ends_the_run() or should_stop()

        return update_and_check
