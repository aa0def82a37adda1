"""Which robots go to which pool: even shares, and as few moves as that takes. Pure."""

from collections.abc import Mapping, Sequence


def shares(total: int, limits: Sequence[int]) -> tuple[int, ...]:
    """Share out `total` as evenly as limits allow; earlier ones get what does not divide.

    Args:
        total: How many there are.
        limits: Most that each may get.
    """
    given = [0] * len(limits)
    # Who has the lowest limit goes first: what it cannot take is left to the others.
    order = sorted(range(len(limits)), key=lambda place: (limits[place], -place))
    for done, place in enumerate(order):
        given[place] = min(limits[place], total // (len(order) - done))
        total -= given[place]
    return tuple(given)


def moves_to(
    asker: str, limits: Mapping[str, int], held: Mapping[str, Sequence[str]], free: Sequence[str]
) -> tuple[str, ...]:
    """Name the robots that a pool gets: of those that are free first, then of other pools' surplus.

    Args:
        asker: The pool; one of `limits`.
        limits: Most robots of each pool, in the order of joining.
        held: What pools have, in the order of claiming; a pool without any may be missing.
        free: Robots that nobody has.
    """
    total = len(free) + sum(len(held.get(pool, ())) for pool in limits)
    quotas = dict(zip(limits, shares(total, tuple(limits.values())), strict=True))
    missing = max(0, quotas[asker] - len(held.get(asker, ())))
    moved = list(free[:missing])
    for pool, quota in quotas.items():
        mine = held.get(pool, ())
        # The newest go: the oldest have been driven by this pool for longest.
        spare = max(0, min(len(mine) - quota, missing - len(moved)))
        moved += mine[len(mine) - spare :]
    return tuple(moved)
