"""CommandedTwists: the twists that clients have ordered, until they release or disappear."""

from dataclasses import dataclass

import numpy as np

from zensim.proto.codec.cdr_reader import MalformedPayload
from zensim.proto.messages.agent_messages import TwistCommands
from zensim.sim_server.physics.engine import FloatArray, IntArray
from zensim.sim_server.world.entity import EntityIndex

COLUMNS = 3
"""Forward, left [m/s], turn [rad/s]."""
NO_CLIENT = -1
MAX_CACHED_ORDERS = 16


@dataclass(frozen=True)
class OrderRows:
    """An order of each entity, or none.

    Attributes:
        twists: (n, 3) NaN where there is none.
        owners: (n,) Number of the client; -1 where there is none.
    """

    twists: FloatArray
    owners: IntArray

    @classmethod
    def make_empty(cls, count: int) -> "OrderRows":
        """Make rows without orders."""
        return cls(np.full((count, COLUMNS), np.nan), np.full(count, NO_CLIENT, dtype=np.int64))

    def set_rows(self, rows: IntArray, twists: FloatArray | float, owners: IntArray | int) -> None:
        """Replace the orders of some rows."""
        self.twists[rows], self.owners[rows] = twists, owners


class CommandedTwists:
    """The newest ordered twist of each entity; NaN where there is none.

    The order before it, of another client, is kept: it holds again if the newest is released.
    """

    def __init__(self) -> None:
        self.changes = 0
        """Counts orders."""
        self._index: EntityIndex | None = None
        self._newest, self._displaced = OrderRows.make_empty(0), OrderRows.make_empty(0)
        self._clients: list[str] = []
        self._is_used = False
        self._ending: IntArray = np.zeros(0, dtype=np.intp)
        """Rows of clients that have gone: zero in one more state."""
        self._rows: dict[tuple[str, ...], tuple[IntArray, IntArray]] = {}

    def order(self, index: EntityIndex, commands: TwistCommands) -> None:
        """Take orders; entities that do not exist are left out.

        A row of NaN ends the order of this client; an order that it displaced holds again.

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
        given = twists[places]
        is_release = np.isnan(given).any(axis=1)
        self._set_orders(rows[~is_release], given[~is_release], client)
        self._release(rows[is_release], client)
        self._is_used = True
        self.changes += 1

    def select(self, index: EntityIndex, rows: IntArray) -> bytes:
        """Select the twists of some rows, as `DriveState.twists`; empty if there is none."""
        if not self._is_used:
            return b""
        self._follow(index)
        selected = self._newest.twists[rows]
        return b"" if np.isnan(selected).all() else selected.tobytes()

    def end_client(self, client: str) -> None:
        """Order zero once for what a client has ordered and no other; then it is released."""
        if client in self._clients:
            number = self._clients.index(client)
            rows = np.flatnonzero(self._newest.owners == number)
            self._release(np.arange(len(self._newest.owners)), number)
            rows = rows[self._newest.owners[rows] == NO_CLIENT]
            self._newest.set_rows(rows, 0.0, NO_CLIENT)
            self._ending = np.union1d(self._ending, rows).astype(np.intp)
            self.changes += 1

    def note_published(self) -> None:
        """Note that all agents were sent the present twists."""
        if len(self._ending):
            rows = self._ending[self._newest.owners[self._ending] == NO_CLIENT]
            self._newest.twists[rows] = np.nan
            self._ending = np.zeros(0, dtype=np.intp)
            self._is_used = not bool(np.isnan(self._newest.twists).all())

    def forget(self, name: str) -> None:
        """Forget the order of a deleted entity."""
        if self._index is not None and (row := self._index.row.get(name)) is not None:
            for orders in (self._newest, self._displaced):
                orders.set_rows(np.array([row]), np.nan, NO_CLIENT)

    def clear(self) -> None:
        """Forget all orders."""
        self._index, self._is_used = None, False
        self._rows, self._clients = {}, []
        self._ending = np.zeros(0, dtype=np.intp)

    def _set_orders(self, rows: IntArray, twists: FloatArray, client: int) -> None:
        """Replace orders; those of other clients are kept as displaced."""
        newest = self._newest
        others = rows[(newest.owners[rows] != NO_CLIENT) & (newest.owners[rows] != client)]
        self._displaced.set_rows(others, newest.twists[others], newest.owners[others])
        newest.set_rows(rows, twists, client)

    def _release(self, rows: IntArray, client: int) -> None:
        """End orders of a client; the displaced orders of others hold again."""
        displaced = self._displaced
        displaced.set_rows(rows[displaced.owners[rows] == client], np.nan, NO_CLIENT)
        own = rows[self._newest.owners[rows] == client]
        self._newest.set_rows(own, displaced.twists[own], displaced.owners[own])
        displaced.set_rows(own, np.nan, NO_CLIENT)

    def _follow(self, index: EntityIndex) -> None:
        """Rearrange the rows when entities have changed."""
        before, self._index = self._index, index
        if before is index:
            return
        former = self._newest, self._displaced
        self._rows = {}
        self._newest, self._displaced = (OrderRows.make_empty(len(index.names)) for _ in former)
        if before is None:
            return
        kept = [(row, index.row[name]) for name, row in before.row.items() if name in index.row]
        if kept:
            old, new = np.array(kept, dtype=np.intp).T
            for orders, last in zip((self._newest, self._displaced), former, strict=True):
                orders.set_rows(new, last.twists[old], last.owners[old])
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
