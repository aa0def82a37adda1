"""CommandedTwists: the twists that clients have ordered, until they release or disappear."""

import numpy as np

from zensim.proto.codec.cdr import MalformedPayload
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.sim_server.world.entity import EntityIndex, IntArray

COLUMNS = 3
"""Forward, left [m/s], turn [rad/s]."""
NO_CLIENT = -1
MAX_CACHED_ORDERS = 16


class CommandedTwists:
    """The newest ordered twist of each entity; NaN where there is none."""

    def __init__(self) -> None:
        self.changes = 0
        """Counts orders."""
        self._index: EntityIndex | None = None
        self._twists = np.zeros((0, COLUMNS))
        self._owners = np.zeros(0, dtype=np.int64)
        self._clients: list[str] = []
        self._is_used = False
        self._ending: IntArray = np.zeros(0, dtype=np.intp)
        """Rows of clients that have gone: zero in one more state."""
        self._rows: dict[tuple[str, ...], tuple[IntArray, IntArray]] = {}

    def order(self, index: EntityIndex, commands: TwistCommands) -> None:
        """Take orders; entities that do not exist are left out.

        A row of NaN ends the order of this client, not one that another client gave after it.

        Raises:
            MalformedPayload: The twists do not fit the entities, or are infinite.
        """
        if len(commands.twists) != 8 * COLUMNS * len(commands.entities):
            raise MalformedPayload(
                f"{len(commands.twists)} bytes of twists for {len(commands.entities)} entities"
            )
        twists = np.frombuffer(commands.twists, dtype="<f8").reshape(-1, COLUMNS)
        if np.isinf(twists).any():
            raise MalformedPayload("a twist is infinite")
        self._follow(index)
        rows, places = self._find_rows(index, commands.entities)
        client = self._number_of(commands.client)
        counts = ~np.isnan(twists[places]).any(axis=1) | (self._owners[rows] == client)
        rows, places = rows[counts], places[counts]
        self._twists[rows] = twists[places]
        self._owners[rows] = client
        self._is_used = True
        self.changes += 1

    def select(self, index: EntityIndex, rows: IntArray) -> bytes:
        """Select the twists of some rows, as `DriveState.twists`; empty if there is none."""
        if not self._is_used:
            return b""
        self._follow(index)
        selected = self._twists[rows]
        return b"" if np.isnan(selected).all() else selected.tobytes()

    def end_client(self, client: str) -> None:
        """Order zero once for what a client has ordered; then it is released."""
        if client in self._clients:
            rows = np.flatnonzero(self._owners == self._clients.index(client))
            self._twists[rows] = 0.0
            self._owners[rows] = NO_CLIENT
            self._ending = np.union1d(self._ending, rows).astype(np.intp)
            self.changes += 1

    def note_published(self) -> None:
        """Note that all agents were sent the present twists."""
        if len(self._ending):
            rows = self._ending[self._owners[self._ending] == NO_CLIENT]
            self._twists[rows] = np.nan
            self._ending = np.zeros(0, dtype=np.intp)
            self._is_used = not bool(np.isnan(self._twists).all())

    def forget(self, name: str) -> None:
        """Forget the order of a deleted entity."""
        if self._index is not None and (row := self._index.row.get(name)) is not None:
            self._twists[row], self._owners[row] = np.nan, NO_CLIENT

    def clear(self) -> None:
        """Forget all orders."""
        self._index, self._is_used = None, False
        self._rows, self._clients = {}, []
        self._ending = np.zeros(0, dtype=np.intp)

    def _follow(self, index: EntityIndex) -> None:
        """Rearrange the rows when entities have changed."""
        before, self._index = self._index, index
        if before is index:
            return
        twists, owners = self._twists, self._owners
        self._rows = {}
        self._twists = np.full((len(index.names), COLUMNS), np.nan)
        self._owners = np.full(len(index.names), NO_CLIENT)
        if before is None:
            return
        kept = [(row, index.row[name]) for name, row in before.row.items() if name in index.row]
        if kept:
            old, new = np.array(kept, dtype=np.intp).T
            self._twists[new], self._owners[new] = twists[old], owners[old]
            places = dict(kept)
            ending = [places[row] for row in self._ending.tolist() if row in places]
            self._ending = np.array(ending, dtype=np.intp)

    def _find_rows(self, index: EntityIndex, names: tuple[str, ...]) -> tuple[IntArray, IntArray]:
        """Find the rows of those entities that exist, and their places among the names."""
        if names not in self._rows:
            if len(self._rows) >= MAX_CACHED_ORDERS:
                self._rows.clear()
            found = [
                (index.row[name], place) for place, name in enumerate(names) if name in index.row
            ]
            pairs = np.array(found, dtype=np.intp).reshape(-1, 2)
            self._rows[names] = pairs[:, 0], pairs[:, 1]
        return self._rows[names]

    def _number_of(self, client: str) -> int:
        if client not in self._clients:
            self._clients.append(client)
        return self._clients.index(client)
