"""Rows, joints and bodies of the entities that an agent has claimed."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from tests.models import a_box, a_cart, an_arm
from tests.sim_server.world.test_entity import make_entities
from zensim.proto.messages.agent_messages import DriveCommand
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.errors import RequestRefused
from zensim.sim_server.world.claim_registry import ClaimedEntities, ClaimRegistry
from zensim.sim_server.world.entity import Entity, make_entity_index

BOX, CART, ARM = a_box(), a_cart(), an_arm("continuous")
EMPTY = np.zeros(0, dtype=np.intp)
models = st.lists(st.sampled_from([BOX, CART, ARM]), max_size=12)


def claim(entities: list[Entity], chosen: list[Entity]) -> ClaimedEntities:
    """Claim some of the entities for one agent, in the order given."""
    registry = ClaimRegistry()
    for entity in chosen:
        registry.grant("a", entity.name, "stop")
    by_name = {entity.name: entity for entity in entities}
    return registry.claimed_by_agent(make_entity_index(entities), by_name)["a"]


def test_claimed_entities_are_in_the_order_of_claiming() -> None:
    entities = make_entities([CART, BOX, ARM, CART])

    claimed = claim(entities, [entities[3], entities[0]])

    assert np.frombuffer(claimed.claims, dtype="<u4").tolist() == [1, 2]
    assert claimed.rows.tolist() == [3, 0]
    assert claimed.joints.tolist() == [3, 4, 0, 1]
    assert claimed.bodies == (103, 100)
    assert claimed.target_count == 4


@pytest.mark.parametrize("model", [BOX, ARM], ids=lambda model: model.name)
def test_claimed_entity_without_a_drive_has_no_targets(model: Model) -> None:
    entities = make_entities([CART, model])

    claimed = claim(entities, [entities[1]])

    assert claimed.target_count == 0
    assert len(claimed.joints) == len(model.joints)


@given(kinds=models, data=st.data())
def test_each_claimed_entity_has_its_own_joints(kinds: list[Model], data: st.DataObject) -> None:
    entities = make_entities(kinds)
    chosen = data.draw(st.permutations(entities).map(lambda mixed: mixed[: len(mixed) // 2]))
    assume(chosen)
    # Each joint is marked with the row of its entity.
    marks = np.concatenate([np.full(len(model.joints), row) for row, model in enumerate(kinds)])

    claimed = claim(entities, chosen)

    rows = [entity.body - 100 for entity in chosen]
    assert claimed.rows.tolist() == rows
    assert marks[claimed.joints].tolist() == [row for row in rows for _ in kinds[row].joints]


def test_agent_that_lost_all_claims_while_silent_keeps_its_next_one() -> None:
    registry = ClaimRegistry()
    registry.grant("a", "r0", "stop")
    registry.note_silent("a")
    registry.drop("r0")

    registry.grant("a", "r1", "stop")

    with pytest.raises(RequestRefused):
        registry.require_free("r1", "b")


def test_command_of_an_agent_without_claims_is_dropped() -> None:
    registry = ClaimRegistry()

    assert not registry.command("a", None, DriveCommand(0, 0, b"", b""))
    assert (registry.taken, registry.dropped) == (0, 1)


def test_claims_are_driven_from_the_next_command_of_their_agent_on() -> None:
    registry, claimed = ClaimRegistry(), ClaimedEntities(b"", EMPTY, EMPTY, (), 0)

    def command(agent: str) -> int:
        assert registry.command(agent, claimed, DriveCommand(0, 0, b"", b""))
        return registry.driven

    registry.grant("a", "r0", "stop")
    registry.grant("a", "r1", "stop")
    seen = [registry.driven, command("a")]
    registry.grant("a", "r2", "stop")
    registry.drop("r0")
    registry.grant("b", "r0", "stop")
    seen += [registry.driven, command("a"), command("b")]
    registry.drop("r2")
    seen.append(registry.driven)
    registry.note_silent("a")

    assert seen == [0, 2, 1, 2, 3, 2]
    assert (registry.driven, registry.agent_count) == (1, 2)


def test_claim_that_moves_from_a_silent_agent_is_not_driven() -> None:
    registry, claimed = ClaimRegistry(), ClaimedEntities(b"", EMPTY, EMPTY, (), 0)
    registry.grant("a", "r0", "stop")
    registry.command("a", claimed, DriveCommand(0, 0, b"", b""))

    registry.grant("b", "r0", "stop")

    assert (registry.driven, registry.agent_count) == (0, 1)
