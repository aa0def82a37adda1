"""Sequences of bodies are split by tier, and the index maps are cached."""

import numpy as np

from zensim.sim_server.physics.kinematic.tier_body_table import (
    MAX_MAPPED_BODIES,
    Tier,
    TierBodyTable,
    TierIndexMapCache,
    split_by_tier,
)


def three_rows() -> TierBodyTable:
    """A kinematic robot with two joints, a full box, and a full robot with one joint."""
    rows = TierBodyTable()
    for row, (tier, joints, width) in enumerate(
        ((Tier.KINEMATIC, 2, 2), (Tier.FULL, 0, 0), (Tier.FULL, 1, 3))
    ):
        rows.add(row)
        rows.tier[row], rows.joint_count[row], rows.width[row] = tier, joints, width
        rows.is_held[row] = joints > 0
    rows.joint_start[:3], rows.target_start[:3] = (10, 0, 12), (20, 0, 22)
    return rows


def test_split_covers_all_joints_and_targets() -> None:
    found = split_by_tier(three_rows(), np.array([2, 0, 1]))

    assert found.bodies == (2, 1)
    assert (found.count, found.joint_count, found.held) == (3, 3, (2, 0))
    assert found.kinematic.places.tolist() == [1]
    assert found.kinematic.joints.tolist() == [1, 2]
    assert found.full.joints.tolist() == [0]
    assert found.pooled_joints.tolist() == [10, 11]
    assert found.full.targets.tolist() == [0, 1, 2]
    assert found.pooled_targets.tolist() == [22, 23, 24, 20, 21]
    assert found.held_targets.tolist() == [0, 1, 2, 3, 4]


def test_row_that_is_used_again_is_zero() -> None:
    rows = three_rows()
    rows.place[:, 1], rows.joint_count[1] = 4.0, 2

    rows.add(1)

    assert (rows.joint_count[1], rows.tier[1]) == (0, Tier.NONE)
    assert not rows.place[:, 1].any()


def test_table_grows_to_a_row_beyond_its_end() -> None:
    rows = three_rows()

    rows.add(1000)

    assert rows.joint_count[[0, 2, 1000]].tolist() == [2, 1, 0]


def test_index_map_is_cached_until_a_change() -> None:
    rows = three_rows()
    mappings, bodies = TierIndexMapCache(rows), (0, 1)
    first = mappings.get(bodies)

    assert mappings.get(bodies) is first
    rows.tier[0] = Tier.FULL
    mappings.invalidate()

    assert mappings.get(bodies).bodies == (0, 1)


def test_index_map_of_a_list_is_not_cached() -> None:
    mappings, bodies = TierIndexMapCache(three_rows()), [0]
    mappings.get(bodies)

    bodies[0] = 1

    assert mappings.get(bodies).bodies == (1,)


def test_unused_index_maps_are_dropped() -> None:
    mappings = TierIndexMapCache(three_rows())
    for number in range(50):
        mappings.get((0, 1, number % 3))
        mappings.invalidate()

    mappings.invalidate()
    mappings.invalidate()

    assert len(mappings) == 0


def test_cached_index_maps_are_bounded_by_their_bodies() -> None:
    mappings = TierIndexMapCache(three_rows())
    used = (0,) * (MAX_MAPPED_BODIES // 4)

    for _ in range(8):
        mappings.get(used)
        mappings.get(tuple([1] * len(used)))

    assert 1 < len(mappings) <= 4
    assert mappings.get(used) is mappings.get(used)
