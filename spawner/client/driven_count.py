"""How many of some robots agents drive, as the server counts them: no topic of a robot is read."""

from collections.abc import Sequence

from zensim.proto.bus import NoServer
from zensim.spawner.client.sim_client import SimClient


class DrivenCount:
    """Counts the robots of a list that agents have commanded.

    A subscription to the odometry of all would make every pool declare a publisher for each robot.
    """

    def __init__(self, client: SimClient, names: Sequence[str]) -> None:
        """Create it for these entities, which were spawned just now."""
        self._client = client
        self._names = frozenset(names)
        self._count = 0

    @property
    def missing(self) -> int:
        """Number of those that were not commanded at the last poll."""
        return len(self._names) - self._count

    def poll(self) -> int:
        """Call the server; return the count, which is that of before if it does not reply."""
        try:
            driven = self._client.info().driven
            if driven < len(self._names):
                # Robots of others may be among them: at least one of ours is missing.
                self._count = max(self._count, min(driven, len(self._names) - 1))
            else:
                self._count = len(self._names & self._client.stats().ready_s.keys())
        except (NoServer, TimeoutError):
            pass
        return self._count
