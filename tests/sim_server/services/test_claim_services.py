"""How robots are shared out among pools."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zensim.sim_server.services.claim_services import find_robots_to_move, split_evenly

MANY = 1 << 32
LIMITS = st.lists(st.integers(0, 30), min_size=1, max_size=6)


@pytest.mark.parametrize(
    ("total", "limits", "given"),
    [
        (10, [MANY], (10,)),
        (10, [MANY, MANY, MANY], (4, 3, 3)),
        (10, [2, MANY, MANY], (2, 4, 4)),
        (10, [1, 2, 3], (1, 2, 3)),
        (0, [MANY, MANY], (0, 0)),
    ],
)
def test_shares_are_even_within_limits(
    total: int, limits: list[int], given: tuple[int, ...]
) -> None:
    assert split_evenly(total, limits) == given


@given(st.integers(0, 100), LIMITS)
def test_shares_give_all_that_limits_allow_and_differ_by_one_below_them(
    total: int, limits: list[int]
) -> None:
    found = split_evenly(total, limits)

    assert sum(found) == min(total, sum(limits))
    assert all(share <= limit for share, limit in zip(found, limits, strict=True))
    open_ones = [share for share, limit in zip(found, limits, strict=True) if share < limit]
    assert not open_ones or max(found) - min(open_ones) <= 1


@given(st.integers(0, 40), LIMITS, st.data())
def test_moves_end_in_even_shares_whoever_asks_and_nothing_is_lost(
    total: int, limits: list[int], data: st.DataObject
) -> None:
    pools = {f"p{number}": limit for number, limit in enumerate(limits)}
    held: dict[str, list[str]] = {pool: [] for pool in pools}
    robots = [f"r{number}" for number in range(total)]

    # Pools come one after another, and each asks again at the end.
    joined: dict[str, int] = {}
    for pool in [*pools, *data.draw(st.permutations(list(pools)))]:
        joined[pool] = pools[pool]
        taken = {name for names in held.values() for name in names}
        moved = find_robots_to_move(pool, joined, held, [one for one in robots if one not in taken])
        for names in held.values():
            names[:] = [name for name in names if name not in moved]
        held[pool] += moved

    sizes = [len(names) for names in held.values()]
    assert tuple(sizes) == split_evenly(total, limits)
    assert len({name for names in held.values() for name in names}) == sum(sizes)


def test_moves_take_free_robots_before_those_of_others() -> None:
    moved = find_robots_to_move("b", {"a": MANY, "b": MANY}, {"a": ["r0", "r1", "r2"]}, ["r3"])

    assert moved == ("r3", "r2")


def test_nobody_moves_when_shares_are_even() -> None:
    held = {"a": ["r0", "r1"], "b": ["r2"]}

    assert find_robots_to_move("a", {"a": MANY, "b": MANY}, held, []) == ()
    assert find_robots_to_move("b", {"a": MANY, "b": MANY}, held, []) == ()
