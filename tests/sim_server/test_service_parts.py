"""Bonds delete their entities and no others; heights over the ground are found once a model."""

import pytest

from tests.models import a_cart
from tests.sim_server.fakes import WallTime, a_spawn, a_world, make_parts, names_in
from tests.sim_server.orders import an_order, spawned
from zensim.proto.messages.model_messages import IDENTITY, Model
from zensim.sim_server import service_parts
from zensim.sim_server.service_parts import ServerParts


def make_bonded_parts(*names: str, bond: str = "b1") -> ServerParts:
    """Make a world with entities of a bond, 5 m apart."""
    wall = WallTime()
    parts = make_parts(a_world("free"), wall)
    parts.bonds.alive.add(bond)
    for i, name in enumerate(names, start=1):
        wall.ns += 1
        spawned(parts, an_order(name, place=(5.0 * i, 0.0, 0.06), bond=bond))
    return parts


def test_bond_deletes_its_entities_when_it_ends() -> None:
    parts = make_bonded_parts("r1", "r2")

    parts.bonds.end("b1")

    assert names_in(parts.world) == ["free"]
    assert parts.bonds.alive == set()


def test_bond_keeps_entities_when_it_is_unknown() -> None:
    parts = make_bonded_parts("r1")

    parts.bonds.end("b2")

    assert names_in(parts.world) == ["free", "r1"]
    assert parts.bonds.alive == {"b1"}


def test_bond_ends_when_its_entity_was_deleted_before() -> None:
    parts = make_bonded_parts("r1", "r2")
    parts.world.delete("r1")

    parts.bonds.end("b1")

    assert names_in(parts.world) == ["free"]


def test_bond_keeps_another_entity_with_the_name() -> None:
    parts = make_bonded_parts("r1")
    parts.world.delete("r1")
    parts.world.spawn(a_spawn("r1"))

    parts.bonds.end("b1")

    assert names_in(parts.world) == ["free", "r1"]


def test_bond_ends_once() -> None:
    parts = make_bonded_parts("r1")
    parts.bonds.end("b1")
    parts.world.spawn(a_spawn("r1"))

    parts.bonds.end("b1")

    assert "r1" in names_in(parts.world)


def test_ground_clearance_is_found_once_for_robots_with_a_model(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    descriptions, model = make_parts(a_world()).descriptions, a_cart()
    first = descriptions.find_ground_clearance(model, IDENTITY)
    monkeypatch.setattr(service_parts, "find_ground_clearance", None)

    assert descriptions.find_ground_clearance(model, IDENTITY) == first


def test_ground_clearances_that_are_kept_are_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    descriptions, found = make_parts(a_world()).descriptions, list[Model]()

    def find(model: Model, *_: object) -> float:
        found.append(model)
        return 0.0

    monkeypatch.setattr(service_parts, "find_ground_clearance", find)
    models = [a_cart() for _ in range(service_parts.MAX_CLEARANCES + 1)]

    for model in (*models, models[0]):
        descriptions.find_ground_clearance(model, IDENTITY)

    assert len(found) == len(models) + 1
