"""The wait until agents drive some robots, as the server counts them: no topic is read."""

import time
from collections.abc import Callable, Sequence
from typing import Final

from zensim.proto.bus.bus_errors import NoServer
from zensim.spawner.client.sim_client import SimClient

POLL_S: Final = 0.01


class NotDriven(TimeoutError):
    """No agent drives some of the robots in time."""


class DrivenCount:
    """Counts the robots of a list that agents drive.

    A robot is driven once an agent has claimed and commanded it. A subscription to the odometry of
    all would make every pool declare a publisher for each robot.
    """

    def __init__(self, client: SimClient, names: Sequence[str]) -> None:
        """Create it for these entities, which were spawned just now."""
        self._client = client
        self._names = frozenset(names)
        self._count = 0
        self.problem: Exception | None = None
        """Why the server did not reply to the last poll; None if it did."""

    @property
    def missing(self) -> int:
        """Number of those that were not driven at the last poll."""
        return len(self._names) - self._count

    def poll(self) -> int:
        """Call the server; return the count, which is that of before if it does not reply."""
        try:
            self._count, self.problem = self._read_count(), None
        except (NoServer, TimeoutError) as error:
            self.problem = error
        return self._count

    def _read_count(self) -> int:
        of_all = self._client.info().driven
        if of_all < len(self._names):
            # Robots of others may be among them: at least one of ours is missing.
            return max(self._count, min(of_all, len(self._names) - 1))
        return len(self._names & self._client.stats().ready_s.keys())


def wait_until_driven(
    client: SimClient,
    names: Sequence[str],
    timeout_s: float,
    on_poll: Callable[[int], None] = lambda _: None,
) -> None:
    """Wait until agents drive these robots, which were spawned just now; see `DrivenCount`.

    Args:
        client: Of their world.
        names: Robots, all with a drive; without any, the server is not called.
        timeout_s: Wall time.
        on_poll: Called with the count after each call of the server; may raise to end the wait.

    Raises:
        NotDriven: No agent drives some of them.
        NoServer: There is no server at the end of that time.
        ServiceError: One of them is not there any more.
    """
    driven, deadline = DrivenCount(client, names), time.monotonic() + timeout_s
    while driven.missing:
        on_poll(driven.poll())
        if driven.missing and time.monotonic() > deadline:
            which = f"'{names[0]}'" if len(names) == 1 else f"{driven.missing} of the robots"
            raise driven.problem or NotDriven(
                f"no agent drives {which} after {timeout_s:.3g} s; "
                "start one with 'zensim agent --pool'"
            )
        if driven.missing:
            time.sleep(POLL_S)
