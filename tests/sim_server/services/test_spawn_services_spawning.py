"""Spawning: what is checked before anything is made, dry runs, strictness, bonds, waiting."""

import numpy as np
import pytest

from tests.sim_server.fakes import (
    InlineParser,
    a_server,
    a_world,
    handle_request,
    make_parts,
    names_in,
)
from tests.sim_server.orders import BOX_BOT
from zensim.proto.messages.model_messages import Inertial, Link, Model, Shape
from zensim.proto.messages.spawn_messages import SpawnEntityOrder, SpawnEntityReport
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.stl import write_corners
from zensim.sim_server.errors import IncorrectState, ModelError, NameNotUnique
from zensim.sim_server.service_parts import ServerParts

FAR = PoseStamped(pose=Pose(Point(50.0, 0.0, 0.06)))
AT_R1 = PoseStamped(pose=Pose(Point(0.0, 0.0, 0.06)))
UNDERGROUND = PoseStamped(pose=Pose(Point(50.0, 0.0, -1.0)))


def an_order(name: str = "new", **wishes: object) -> SpawnEntityOrder:
    fields: dict[str, object] = {"entity_resource": BOX_BOT, "initial_pose": FAR}
    return SpawnEntityOrder(name, **{**fields, **wishes})  # type: ignore[arg-type]


def suspicions(report: SpawnEntityReport) -> list[str]:
    return [entry.reason for entry in report.report if entry.status == "suspicious"]


def descriptions_of(parts: ServerParts) -> InlineParser:
    assert isinstance(parts.descriptions.provider, InlineParser)
    return parts.descriptions.provider


def spawned(world_names: list[str], order: SpawnEntityOrder) -> tuple[SpawnEntityReport, list[str]]:
    parts = make_parts(a_world(*world_names))
    report = handle_request(parts, order)
    assert isinstance(report, SpawnEntityReport)
    return report, names_in(parts.world)


def test_dry_run_says_the_name_and_spawns_nothing() -> None:
    report, names = spawned(["new"], an_order(dry_run=True, allow_renaming=True))

    assert report.entity_name == "new_1"
    assert names == ["new"]


def test_dry_run_tells_nobody() -> None:
    parts = make_parts(a_world())

    handle_request(parts, an_order(dry_run=True, initial_pose=UNDERGROUND))

    assert parts.world.clock.take_events() == []


def test_dry_run_is_refused_as_the_spawn_would_be() -> None:
    with pytest.raises(NameNotUnique):
        spawned(["new"], an_order(dry_run=True))


@pytest.mark.parametrize("is_dry", [False, True])
def test_report_names_what_stands_there(*, is_dry: bool) -> None:
    report, _ = spawned(["r1"], an_order(initial_pose=AT_R1, dry_run=is_dry))

    assert suspicions(report) == ["overlaps entity 'r1'"]


@pytest.mark.parametrize(("pose", "fault"), [(AT_R1, "'r1'"), (UNDERGROUND, "initial_pose")])
def test_strict_spawn_is_refused_and_leaves_nothing(pose: PoseStamped, fault: str) -> None:
    parts = make_parts(a_world("r1"))

    with pytest.raises(ModelError, match=rf"^report\.suspicious: .*{fault}"):
        handle_request(parts, an_order(strict=True, initial_pose=pose))

    assert names_in(parts.world) == ["r1"]


def test_strict_spawn_is_made_when_nothing_is_suspicious() -> None:
    report, names = spawned([], an_order(strict=True))

    assert suspicions(report) == []
    assert names == ["new"]


def test_robot_stands_on_the_lowest_corner_of_its_meshes() -> None:
    parts = make_parts(a_world())
    corners = np.array([[[0.0, 0.0, -0.25], [1.0, 0.0, 0.0], [0.0, 1.0, 0.5]]])
    parts.store.pin("a" * 64, write_corners(corners))
    shape = Shape("mesh", (1.0, 1.0, 2.0), mesh="a" * 64)
    descriptions_of(parts).given = Model("m", (Link("base", Inertial(1.0), (shape,)),))

    snapped = handle_request(parts, an_order("high", snap_to_ground=True))
    sunk = handle_request(parts, an_order("low", initial_pose=FAR))

    assert isinstance(snapped, SpawnEntityReport)
    assert isinstance(sunk, SpawnEntityReport)
    assert suspicions(snapped) == []
    assert parts.world.state_of("high")[2] == pytest.approx(0.5)
    assert any("44.0 cm below ground" in reason for reason in suspicions(sunk))


def test_bond_without_a_token_is_refused() -> None:
    with pytest.raises(IncorrectState, match="'b1'"):
        spawned([], an_order(bond="b1"))


def test_entity_goes_when_its_bond_goes() -> None:
    server = a_server("r1")
    server.inbox.bonds.append(("b1", True))
    server.ask("spawn_entity", an_order(bond="b1"))
    server.loop.serve()
    bound = names_in(server.world)

    server.inbox.bonds.append(("b1", False))
    server.loop.serve()

    assert bound == ["r1", "new"]
    assert names_in(server.world) == ["r1"]


def test_bond_that_goes_leaves_another_entity_of_the_name_alone() -> None:
    server = a_server()
    server.inbox.bonds.append(("b1", True))
    server.ask("spawn_entity", an_order(bond="b1"))
    server.loop.serve()
    server.world.delete("new")
    server.wall.ns += 1
    server.ask("spawn_entity", an_order())
    server.loop.serve()

    server.inbox.bonds.append(("b1", False))
    server.loop.serve()

    assert names_in(server.world) == ["new"]


def test_spawns_wait_for_reading_and_are_made_in_order_of_asking() -> None:
    server = a_server()
    reader = InlineParser()
    reader.is_slow = True
    server.parts.descriptions.provider = reader
    calls = [server.ask("spawn_entity", an_order(name)) for name in ("a", "b")]
    server.loop.serve()
    before = [call.is_over for call in calls]

    reader.is_slow = False
    server.loop.serve()

    assert before == [False, False]
    assert [call.is_over for call in calls] == [True, True]
    assert names_in(server.world) == ["a", "b"]


def test_retry_takes_the_place_of_a_spawn_that_waits() -> None:
    server = a_server()
    reader = InlineParser()
    reader.is_slow = True
    server.parts.descriptions.provider = reader
    first = server.ask("spawn_entity", an_order("a"))
    first.request_id = b"1"
    server.loop.serve()
    again = server.ask("spawn_entity", an_order("a"))
    again.request_id = b"1"
    server.loop.serve()

    reader.is_slow = False
    server.loop.serve()

    assert (first.is_over, again.is_over) == (False, True)
    assert names_in(server.world) == ["a"]


def test_world_steps_on_while_a_spawn_waits() -> None:
    server = a_server("r1")
    reader = InlineParser()
    reader.is_slow = True
    server.parts.descriptions.provider = reader
    server.ask("spawn_entity", an_order("a"))
    steps = server.world.clock.steps
    server.turn_for(0.1)

    assert server.world.clock.steps > steps
