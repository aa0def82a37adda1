"""Roster and fleets: where entities and their joints stand in the arrays."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.models import a_box, a_cart, a_state, an_arm
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.world.entity import ClaimRecord, Entity, make_entity_index, select_claimed

BOX, CART, ARM = a_box(), a_cart(), an_arm("continuous")
models = st.lists(st.sampled_from([BOX, CART, ARM]), max_size=12)


def entities_of(kinds: list[Model]) -> list[Entity]:
    return [
        Entity(f"r{i}", f"r{i}", model, 100 + i, a_state(), "", 0) for i, model in enumerate(kinds)
    ]


def test_roster_lines_entities_up_with_their_joints() -> None:
    roster = make_entity_index(entities_of([CART, BOX, ARM, CART]))

    assert roster.names == ("r0", "r1", "r2", "r3")
    assert roster.bodies == (100, 101, 102, 103)
    assert roster.row == {"r0": 0, "r1": 1, "r2": 2, "r3": 3}
    assert roster.joint_start.tolist() == [0, 2, 2, 3]
    assert roster.joint_count.tolist() == [2, 0, 1, 2]


def test_roster_is_empty_when_nobody_is_there() -> None:
    roster = make_entity_index([])

    assert (roster.names, roster.bodies, roster.row) == ((), (), {})
    assert roster.joint_start.shape == roster.joint_count.shape == (0,)


def test_fleet_is_cut_in_the_order_of_claiming() -> None:
    entities = entities_of([CART, BOX, ARM, CART])
    members = [
        (entities[3], ClaimRecord(7, "a", "stop")),
        (entities[0], ClaimRecord(9, "a", "stop")),
    ]

    fleet = select_claimed(make_entity_index(entities), members)

    assert np.frombuffer(fleet.claims, dtype="<u4").tolist() == [7, 9]
    assert fleet.rows.tolist() == [3, 0]
    assert fleet.joints.tolist() == [3, 4, 0, 1]
    assert fleet.bodies == (103, 100)
    assert fleet.target_count == 4


@pytest.mark.parametrize("model", [BOX, ARM], ids=lambda model: model.name)
def test_fleet_has_no_targets_when_its_entity_has_no_drive(model: Model) -> None:
    entities = entities_of([CART, model])

    fleet = select_claimed(
        make_entity_index(entities), [(entities[1], ClaimRecord(1, "a", "stop"))]
    )

    assert fleet.target_count == 0
    assert len(fleet.joints) == len(model.joints)


@given(kinds=models, data=st.data())
def test_fleet_reads_each_member_the_joints_that_are_its_own(
    kinds: list[Model], data: st.DataObject
) -> None:
    entities = entities_of(kinds)
    chosen = data.draw(st.permutations(entities).map(lambda mixed: mixed[: len(mixed) // 2]))
    # Every joint is marked with the row of its entity.
    marks = np.concatenate(
        [np.zeros(0), *(np.full(len(model.joints), row) for row, model in enumerate(kinds))]
    )

    fleet = select_claimed(
        make_entity_index(entities),
        [(entity, ClaimRecord(i, "a", "stop")) for i, entity in enumerate(chosen)],
    )

    rows = [entity.body - 100 for entity in chosen]
    assert fleet.rows.tolist() == rows
    assert marks[fleet.joints].tolist() == [row for row in rows for _ in kinds[row].joints]
