"""Bonds: what hangs on one goes with it, and nothing else."""

from tests.sim_server.fakes import WallTime, a_birth, a_desk, a_world, names_in
from tests.sim_server.orders import an_order, spawned
from zensim.sim_server.server_context import ServerContext


def a_bonded_desk(*names: str, bond: str = "b1") -> ServerContext:
    """A desk whose world has entities that hang on a bond, 5 m apart."""
    wall = WallTime()
    desk = a_desk(a_world("free"), wall)
    desk.alive_bonds.add(bond)
    for i, name in enumerate(names, start=1):
        wall.ns += 1
        spawned(desk, an_order(name, place=(5.0 * i, 0.0, 0.06), bond=bond))
    return desk


def test_bond_takes_its_entities_out_when_it_ends() -> None:
    desk = a_bonded_desk("r1", "r2")

    desk.delete_bonded_entities("b1")

    assert names_in(desk.world) == ["free"]
    assert desk.alive_bonds == set()


def test_bond_leaves_everything_when_it_is_unknown() -> None:
    desk = a_bonded_desk("r1")

    desk.delete_bonded_entities("b2")

    assert names_in(desk.world) == ["free", "r1"]
    assert desk.alive_bonds == {"b1"}


def test_bond_ends_when_its_entity_was_deleted_before() -> None:
    desk = a_bonded_desk("r1", "r2")
    desk.world.delete("r1")

    desk.delete_bonded_entities("b1")

    assert names_in(desk.world) == ["free"]


def test_bond_leaves_another_entity_that_got_the_name_since() -> None:
    desk = a_bonded_desk("r1")
    desk.world.delete("r1")
    desk.world.spawn(a_birth("r1"))

    desk.delete_bonded_entities("b1")

    assert names_in(desk.world) == ["free", "r1"]


def test_bond_ends_once() -> None:
    desk = a_bonded_desk("r1")
    desk.delete_bonded_entities("b1")
    desk.world.spawn(a_birth("r1"))

    desk.delete_bonded_entities("b1")

    assert "r1" in names_in(desk.world)
