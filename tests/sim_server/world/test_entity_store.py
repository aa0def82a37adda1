"""Entities by name, those staged, and the owners of names, namespaces and bodies."""

from dataclasses import replace

import pytest

from tests.models import a_box, a_cart, a_state
from zensim.proto.messages.entity_messages import EntityInfo
from zensim.sim_server.errors import EntityNotFound
from zensim.sim_server.world.entity import Entity, make_entity_index
from zensim.sim_server.world.entity_store import EntityStore

BOX = a_box()


def an_entity(name: str, namespace: str = "", body: int = 1) -> Entity:
    return Entity(name, namespace, BOX, body, a_state(), "", 0)


def a_store(*entities: Entity) -> EntityStore:
    store = EntityStore()
    for entity in entities:
        store.stage(entity)
        store.commit(entity)
    return store


def test_store_has_entities_in_the_order_of_commits() -> None:
    store = a_store(an_entity("b", body=1), an_entity("a", body=2))

    assert [entity.name for entity in store] == ["b", "a"]
    assert (len(store), "a" in store, "c" in store) == (2, True, False)
    assert store.find("a").body == 2
    assert store.index.names == ("b", "a")


def test_entities_may_be_removed_while_iterating() -> None:
    store = a_store(an_entity("a", body=1), an_entity("b", body=2))

    for entity in store:
        store.remove(entity.name)

    assert len(store) == 0


@pytest.mark.parametrize("method", ["find", "remove"])
def test_entity_that_does_not_exist_is_not_found(method: str) -> None:
    with pytest.raises(EntityNotFound):
        getattr(a_store(), method)("a")


def test_bodies_have_owners() -> None:
    store = a_store(an_entity("a", body=1), an_entity("b", body=2))

    assert store.find_owners([2, 3, 1]) == ["b", "a"]


def test_staged_entity_has_its_names_and_body_but_is_not_listed() -> None:
    store, entity = EntityStore(), an_entity("a", "team/a")
    store.stage(entity)

    assert (len(store), "a" in store, store.staged) == (0, False, (entity,))
    assert store.is_staged(entity)
    assert (store.names, store.namespace_owners) == ({"a"}, {"team/a": "a"})
    assert store.find_owners([1]) == ["a"]
    assert store.roster_number == 0


@pytest.mark.parametrize("ending", ["remove", "rollback"])
def test_entity_that_is_gone_owns_nothing(ending: str) -> None:
    store, entity = EntityStore(), an_entity("a", "team/a")
    store.stage(entity)
    if ending == "remove":
        store.commit(entity)
        store.remove("a")
    else:
        store.rollback(entity)

    assert not store.is_staged(entity)
    assert (len(store), store.staged) == (0, ())
    assert (store.names, store.namespace_owners, store.find_owners([1])) == (set(), {}, [])


def test_entities_without_a_namespace_leave_all_namespaces_free() -> None:
    store = a_store(an_entity("a", body=1), an_entity("b", body=2))

    store.remove("a")

    assert (store.names, store.namespace_owners) == ({"b"}, {})


def test_roster_number_counts_entities_and_models_but_not_bodies_and_infos() -> None:
    store = a_store(an_entity("a"))
    numbers = [store.roster_number]
    for changed in (
        replace(store.find("a"), body=7),
        replace(store.find("a"), body=7, info=EntityInfo(description="a box")),
        replace(store.find("a"), body=7, model=a_cart()),
    ):
        store.replace(changed)
        numbers.append(store.roster_number)
    store.remove("a")

    assert [*numbers, store.roster_number] == [1, 1, 1, 2, 3]


def test_index_follows_another_body() -> None:
    store = a_store(an_entity("a", body=1))
    before = store.index.bodies

    store.replace(replace(store.find("a"), body=2))

    assert (before, store.index.bodies) == ((1,), (2,))
    assert store.find_owners([1, 2]) == ["a"]


def test_all_entities_are_replaced_and_staged_ones_dropped() -> None:
    store, staged = a_store(an_entity("a", "ns", body=1)), an_entity("s", body=2)
    store.stage(staged)

    store.replace_all([an_entity("b", body=1)])

    assert [entity.name for entity in store] == ["b"]
    assert not store.is_staged(staged)
    assert (store.names, store.namespace_owners) == ({"b"}, {})
    assert store.find_owners([1, 2]) == ["b"]
    assert store.roster_number == 2


def test_appended_entities_move_no_rows() -> None:
    store = a_store(an_entity("a", body=1))
    cart = a_cart()
    for number, model in ((2, cart), (3, BOX), (4, cart)):
        entity = replace(an_entity(f"e{number}", body=number), model=model)
        store.stage(entity)
        before = store.index
        store.commit(entity)

        index, whole = store.index, make_entity_index(tuple(store))

        assert before.names == index.names[:-1]
        assert (index.names, index.bodies, index.row) == (whole.names, whole.bodies, whole.row)
        assert index.joint_start.tolist() == whole.joint_start.tolist()
        assert index.joint_count.tolist() == whole.joint_count.tolist()


def test_changes_are_listed_from_the_first_call_on() -> None:
    store = a_store(an_entity("a", body=1))
    first = store.take_changed()
    for name, body in (("b", 2), ("c", 3)):
        store.stage(an_entity(name, body=body))
        store.commit(store.staged[0])
    store.replace(an_entity("a", body=4))
    store.remove("b")

    assert first is None
    assert store.take_changed() == ["c", "a", "b"]
    assert store.take_changed() == []


def test_changes_are_not_known_after_all_entities_were_replaced() -> None:
    store = a_store(an_entity("a", body=1))
    store.take_changed()

    store.replace_all([an_entity("b", body=2)])

    assert store.take_changed() is None
