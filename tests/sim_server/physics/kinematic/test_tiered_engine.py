"""Auto robots switch to full dynamics before contact, smoothly, and back."""

import math
from itertools import pairwise

import numpy as np
import pytest

from tests.models import a_box, a_box_bot, a_state, an_arm, box_bot_at
from tests.sim_server.physics.kinematic.tiered_worlds import (
    DT_S,
    STEP_NS,
    places,
    steps,
    two_tiers,
    with_dynamics,
)
from zensim.proto.messages.model_messages import Dynamics
from zensim.sim_server.physics.bullet.pybullet_engine import PyBulletEngine
from zensim.sim_server.physics.engine_config import EngineConfig
from zensim.sim_server.physics.kinematic.proximity_index import (
    MAX_APPENDED_DISCS,
    NEIGHBOUR_MARGIN_M,
    NeighbourLists,
)
from zensim.sim_server.physics.kinematic.tiered_engine import TieredEngine
from zensim.sim_server.scene.footprints import StaticEdges

EITHER: tuple[Dynamics, ...] = ("auto", "full")
ALL: tuple[Dynamics, ...] = ("", "full", "kinematic", "auto")
SPEED = 15.0
AHEAD = SPEED * 0.035


def test_robot_without_moving_neighbours_is_kinematic() -> None:
    with two_tiers() as engine:
        alone = engine.add(a_box_bot(), box_bot_at())
        pair = [engine.add(a_box_bot(), box_bot_at(5.0, y)) for y in (0.0, 0.15)]

        engine.command((alone,), np.full(2, SPEED))
        steps(engine, 100)

        assert [engine.tier_of(body) for body in (alone, *pair)] == ["kinematic"] * 3


def test_robots_are_full_before_contact_and_push_each_other() -> None:
    found = []
    for default in EITHER:
        with two_tiers(default) as engine:
            left = engine.add(a_box_bot(), box_bot_at(0.0))
            right = engine.add(a_box_bot(), box_bot_at(1.0, 0.0, math.pi))
            engine.command((left, right), np.full(4, SPEED))
            while np.diff(places(engine, [left, right])[:, 0])[0] > 0.19:
                engine.step()
            assert engine.tier_of(left) == engine.tier_of(right) == "full"
            steps(engine, 200)
            found.append(places(engine, [left, right]))
            assert engine.tier_of(left) == "full"
    assert np.diff(found[0][:, 0]) == pytest.approx(np.diff(found[1][:, 0]), abs=0.02)


def test_robot_passes_another_smoothly_and_is_kinematic_again() -> None:
    with two_tiers() as engine:
        body = engine.add(a_box_bot(), box_bot_at())
        engine.add(a_box_bot(), box_bot_at(2.0, 0.195))
        engine.command((body,), np.full(2, SPEED))
        steps(engine, 60)
        tiers = []
        before = engine.read((body,))
        for _ in range(600):
            engine.step()
            after = engine.read((body,))
            assert np.hypot(*(after.base[0, :2] - before.base[0, :2])) == pytest.approx(
                AHEAD * DT_S, abs=2e-4
            )
            assert after.base[0, 7:] == pytest.approx(before.base[0, 7:], abs=0.005)
            assert after.joint_positions - before.joint_positions == pytest.approx(
                [SPEED * DT_S] * 2, abs=1e-3
            )
            tiers.append(engine.tier_of(body))
            before = after
        assert tiers[0] == tiers[-1] == "kinematic"
        assert "full" in tiers
        assert sum(one != other for one, other in pairwise(tiers)) == 2


def test_wrench_makes_a_robot_full_until_it_has_settled() -> None:
    with two_tiers() as engine:
        body = engine.add(a_box_bot(), box_bot_at())
        steps(engine, 5)

        engine.apply_link_wrench(body, 0, np.array([0.0, 40.0, 0.0, 0.0, 0.0, 0.0]))

        assert engine.tier_of(body) == "full"
        steps(engine, 1)
        assert engine.read((body,)).base[0, 8] > 0.1
        steps(engine, 200)
        assert engine.tier_of(body) == "kinematic"


def test_falling_robot_is_full_until_it_stands() -> None:
    with two_tiers() as engine:
        body = engine.add(a_box_bot(), a_state((0.0, 0.0, 0.5)))

        assert engine.tier_of(body) == "full"
        steps(engine, 300)

        assert engine.tier_of(body) == "kinematic"
        assert engine.read((body,)).base[0, 2] == pytest.approx(0.06, abs=0.002)


def test_robot_under_a_falling_box_is_full() -> None:
    with two_tiers() as engine:
        body = engine.add(a_box_bot(), box_bot_at())
        box = engine.add(a_box(), a_state((0.0, 0.0, 1.0)))

        steps(engine, 300)

        assert engine.tier_of(body) == "full"
        assert engine.read((box,)).base[0, 2] > 0.15


def test_robot_beyond_its_lateral_grip_is_full() -> None:
    with two_tiers() as engine:
        body = engine.add(a_box_bot(), box_bot_at())
        engine.command((body,), np.array([40.0, 75.0]))

        steps(engine, 150)

        assert engine.tier_of(body) == "full"


def test_removed_and_reset_robots_leave_no_bodies() -> None:
    with two_tiers() as engine:
        first, second = (engine.add(a_box_bot(), box_bot_at(x)) for x in (0.0, 0.3))
        engine.command((first,), np.full(2, SPEED))
        steps(engine, 60)
        assert engine.tier_of(first) == "full"

        engine.remove(second)
        engine.set_at_rest(first, box_bot_at())
        steps(engine, 60)

        assert engine.tier_of(first) == "kinematic"
        assert engine.read((first,)).base[0].tolist() == box_bot_at().tolist()
        assert engine.add(a_box_bot(), box_bot_at(1.0)) == second


def drive_meeting() -> bytes:
    with two_tiers() as engine:
        bodies = tuple(
            engine.add(a_box_bot(), box_bot_at(0.4 * (i % 5), 0.4 * (i // 5), 1.3 * i))
            for i in range(20)
        )
        box = engine.add(a_box(), a_state((0.2, 0.2, 0.1)))
        draw = np.random.default_rng(3)
        for _ in range(6):
            engine.command(bodies, draw.uniform(-12.0, 14.0, 40))
            steps(engine, 25)
        reading = engine.read((*bodies, box))
        return reading.base.tobytes() + reading.joint_positions.tobytes()


def test_same_calls_give_the_same_bits() -> None:
    assert drive_meeting() == drive_meeting()


def test_each_robot_has_its_own_dynamics() -> None:
    with two_tiers("full") as engine:
        bodies = [
            engine.add(with_dynamics(a_box_bot(), asked), box_bot_at(float(x)))
            for x, asked in enumerate(ALL)
        ]

        assert [engine.tier_of(body) for body in bodies] == [
            "full",
            "full",
            "kinematic",
            "kinematic",
        ]
        assert engine.kinematic_count == 2
        assert list(engine.find_overlaps(bodies[2])) == []


def test_overlaps_across_tiers_are_found() -> None:
    with two_tiers("full") as engine:
        box = engine.add(a_box(), a_state((0.0, 0.0, 0.1)))
        near = engine.add(with_dynamics(a_box_bot(), "auto"), box_bot_at(0.1))
        beside = engine.add(with_dynamics(a_box_bot(), "auto"), box_bot_at(0.25, 0.0))

        assert list(engine.find_overlaps(near)) == [box]
        assert list(engine.find_overlaps(box)) == [near]
        assert list(engine.find_overlaps(beside)) == []


def test_arm_on_a_fixed_post_moves_beside_kinematic_robots_only() -> None:
    with two_tiers() as engine:
        engine.add(a_box_bot(), box_bot_at())
        arm = engine.add(an_arm("revolute"), a_state((5.0, 0.0, 0.0)))
        steps(engine, 200)

        assert engine.kinematic_count == 1
        assert engine.read((arm,)).joint_positions == pytest.approx([0.5], abs=0.01)


def test_contacts_of_the_first_body_of_a_world_without_ground_are_read() -> None:
    config = EngineConfig(STEP_NS, has_ground=False)
    engine = TieredEngine(PyBulletEngine(config), config, "full")
    table = engine.add(a_box("table", is_static=True), a_state())
    box = engine.add(a_box(), a_state((0.0, 0.0, 0.2)))
    steps(engine, 50)

    touched = [engine.read_contacts((body,)).bodies[:, 2].tolist() for body in (table, box)]

    engine.close()
    assert set(touched[0]) == {box}
    assert set(touched[1]) == {table}


def pairs_of(lists: NeighbourLists) -> tuple[set[tuple[int, int]], set[tuple[int, int]]]:
    """List pairs of discs, the lower index first, and pairs of a disc and an edge."""
    discs = zip(lists.one.tolist(), lists.other.tolist(), strict=True)
    edges = zip(lists.disc.tolist(), lists.edge.tolist(), strict=True)
    return {(min(pair), max(pair)) for pair in discs}, set(edges)


@pytest.mark.parametrize("added", [1, 7, MAX_APPENDED_DISCS, MAX_APPENDED_DISCS + 1])
def test_appended_discs_have_the_pairs_of_new_lists(added: int) -> None:
    random = np.random.default_rng(7)
    count = 40 + added
    centres = random.uniform(0.0, 6.0, (count, 2))
    radius, way = random.uniform(0.1, 0.4, count), random.uniform(0.0, 0.05, count)
    edges = StaticEdges(np.array([[0.0, 3.0, 6.0, 3.0]]), np.array([0.1]), np.array([[0.0, 1.0]]))
    grown, whole = NeighbourLists(NEIGHBOUR_MARGIN_M), NeighbourLists(NEIGHBOUR_MARGIN_M)
    for lists in (grown, whole):
        lists.set_edges(edges)
    grown.refresh(centres[:40], radius[:40], way[:40])

    grown.refresh(centres, radius, way)
    whole.refresh(centres, radius, way)

    assert pairs_of(grown) == pairs_of(whole)


def test_robot_that_is_added_on_the_way_of_another_makes_both_full() -> None:
    with two_tiers() as engine:
        left = engine.add(a_box_bot(), box_bot_at(0.0))
        engine.command((left,), np.full(2, SPEED))
        steps(engine, 20)
        x = float(places(engine, [left])[0, 0])

        right = engine.add(a_box_bot(), box_bot_at(x + 0.5))
        while np.diff(places(engine, [left, right])[:, 0])[0] > 0.19:
            engine.step()

        assert engine.tier_of(left) == engine.tier_of(right) == "full"


def test_robot_in_the_row_of_one_that_was_removed_has_its_own_neighbours() -> None:
    with two_tiers() as engine:
        left = engine.add(a_box_bot(), box_bot_at(0.0))
        far = engine.add(a_box_bot(), box_bot_at(30.0))
        engine.command((left,), np.full(2, SPEED))
        steps(engine, 20)
        x = float(places(engine, [left])[0, 0])
        engine.remove(far)

        right = engine.add(a_box_bot(), box_bot_at(x + 0.5))
        while np.diff(places(engine, [left, right])[:, 0])[0] > 0.19:
            engine.step()

        assert right == far
        assert engine.tier_of(right) == "full"


@pytest.mark.parametrize("dynamics", ["auto", "kinematic"])
def test_hidden_robot_stops_no_other_until_it_is_shown(dynamics: Dynamics) -> None:
    with two_tiers(dynamics) as engine:
        model = a_box_bot()
        driven = engine.add(model, box_bot_at(0.0))
        hidden = engine.add(model, box_bot_at(1.0))
        overlapping = engine.add(model, box_bot_at(1.05))
        engine.hide(hidden)
        engine.command((driven, hidden), np.full(4, 10.0))

        assert list(engine.find_overlaps(overlapping)) == [hidden]
        engine.remove(overlapping)
        steps(engine, 500)
        passed, waiting = places(engine, [driven, hidden])[:, 0]
        assert (passed > 1.5, waiting) == (True, 1.0)
        assert engine.kinematic_count == 2

        engine.command((hidden,), np.zeros(2))
        engine.show((hidden,))
        other = engine.add(model, box_bot_at(0.0))
        engine.command((other,), np.full(2, 10.0))
        steps(engine, 400)
        if dynamics == "kinematic":
            assert places(engine, [other])[0, 0] < 1.0
        else:
            assert places(engine, [hidden])[0, 0] > 1.0
