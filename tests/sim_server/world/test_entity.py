"""Index of entities and their joints in the state arrays."""

from tests.models import a_box, a_cart, a_state, an_arm
from zensim.proto.messages.model_messages import Model
from zensim.sim_server.world.entity import Entity, make_entity_index

BOX, CART, ARM = a_box(), a_cart(), an_arm("continuous")


def make_entities(kinds: list[Model]) -> list[Entity]:
    return [
        Entity(f"r{i}", f"r{i}", model, 100 + i, a_state(), "", 0) for i, model in enumerate(kinds)
    ]


def test_index_has_rows_of_entities_and_joints() -> None:
    index = make_entity_index(make_entities([CART, BOX, ARM, CART]))

    assert index.names == ("r0", "r1", "r2", "r3")
    assert index.bodies == (100, 101, 102, 103)
    assert index.row == {"r0": 0, "r1": 1, "r2": 2, "r3": 3}
    assert index.joint_start.tolist() == [0, 2, 2, 3]
    assert index.joint_count.tolist() == [2, 0, 1, 2]


def test_index_is_empty_without_entities() -> None:
    index = make_entity_index([])

    assert (index.names, index.bodies, index.row) == ((), (), {})
    assert index.joint_start.shape == index.joint_count.shape == (0,)
