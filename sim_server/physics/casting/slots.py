"""Slots: how many a cast has of each make, and whose they are."""

from zensim.sim_server.physics.casting.make import Make

Cast = tuple[tuple[Make, int], ...]
"""Makes in the order of their first body, each with its number of slots."""
FREE = None


def room_for(count: int) -> int:
    """Find how many slots to have for so many bodies: the next power of 2."""
    return 1 << (count - 1).bit_length()


class Slots:
    """Gives slots to bodies, the lowest that is free first: what was before leaves no trace."""

    def __init__(self) -> None:
        self._owners: dict[Make, list[int | None]] = {}

    @property
    def cast(self) -> Cast:
        """What is to be compiled for these slots."""
        return tuple((make, len(owners)) for make, owners in self._owners.items())

    def with_one_more(self, make: Make) -> Cast:
        """Say what the cast is once one more body of a make has a slot."""
        owners = self._owners.get(make, [])
        count = len(owners) if FREE in owners else room_for(len(owners) + 1)
        return tuple({**dict(self.cast), make: count}.items())

    def take(self, make: Make, body: int) -> int:
        """Give a body a slot of its make, of which there are more from now on if it needs be."""
        owners = self._owners.setdefault(make, [])
        if FREE not in owners:
            owners.extend([FREE] * (room_for(len(owners) + 1) - len(owners)))
        slot = owners.index(FREE)
        owners[slot] = body
        return slot

    def release(self, make: Make, slot: int) -> None:
        """Take a slot back."""
        self._owners[make][slot] = FREE
