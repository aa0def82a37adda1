"""A server whose engine raises exceptions for one robot: it refuses or freezes only that robot."""

import os
from collections.abc import Iterator

import pytest

from tests.contract.repository import ROOT
from tests.integration.processes import Server, eventually, serving
from tests.sim_server.description.robots import a_collision, a_link, a_robot, an_inertial
from zensim.proto.codec.message_codec import decode
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.messages.spawn_messages import (
    Resource,
    SpawnEntitiesOrder,
    SpawnEntity,
    SpawnEntityOrder,
)
from zensim.proto.messages.standard_messages import Point, Pose, PoseStamped
from zensim.proto.messages.telemetry_messages import Event
from zensim.proto.topic_catalog import EVENTS

USE_FAULTY_ENGINE = """
from zensim.sim_server.physics import engine_factory
engine_factory.ENGINE_CLASSES["pybullet"] = ("tests.faulty_engines", "FaultyBullet")
"""
GOOD = SpawnEntityOrder("good", entity_resource=Resource(uri="box_bot"))
FAR = PoseStamped(pose=Pose(Point(x=30.0, z=1.0)))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Server]:
    folder = tmp_path_factory.mktemp("site")
    (folder / "sitecustomize.py").write_text(USE_FAULTY_ENGINE, encoding="utf-8")
    prefix = ("env", f"PYTHONPATH={os.pathsep.join((str(folder), str(ROOT)))}")
    with serving("--engine", "pybullet", prefix=prefix) as found:
        found.client.spawn(GOOD)
        yield found


@pytest.fixture(autouse=True)
def surviving(server: Server) -> Iterator[None]:
    yield
    before = server.steps()
    eventually(lambda: server.steps() > before + 20, 5.0, "stepping")
    assert server.process.poll() is None
    assert server.client.entities() == ("good",)


def a_culprit(method: str, *, is_dry_run: bool = False) -> SpawnEntityOrder:
    body = a_link("base", an_inertial() + a_collision())
    text = a_robot(body, attributes=f'name="culprit.{method}"')
    return SpawnEntityOrder(
        "culprit",
        entity_resource=Resource(resource_string=text),
        initial_pose=FAR,
        dry_run=is_dry_run,
    )


@pytest.mark.parametrize("method", ["insert", "find_overlaps"])
@pytest.mark.parametrize("is_dry_run", [True, False], ids=["dry run", "spawn"])
def test_spawn_is_refused_when_the_engine_fails(
    server: Server, method: str, *, is_dry_run: bool
) -> None:
    with pytest.raises(ServiceError) as refused:
        server.client.spawn(a_culprit(method, is_dry_run=is_dry_run))

    assert refused.value.message.startswith("engine.refused: ")


@pytest.mark.parametrize("method", ["insert", "find_overlaps"])
@pytest.mark.parametrize("is_atomic", [True, False], ids=["atomic", "independent"])
def test_batch_is_refused_when_the_engine_fails(
    server: Server, method: str, *, is_atomic: bool
) -> None:
    wanted = SpawnEntitiesOrder(
        spawn_requests=(SpawnEntity("culprit", initial_pose=FAR),),
        common=a_culprit(method),
        atomic=is_atomic,
    )

    (result,) = server.client.spawn_all(wanted).results

    assert result.result.error_message.startswith("engine.refused: ")


@pytest.mark.parametrize("method", ["read", "step", "set_base_state", "discard"])
def test_entity_is_frozen_or_deleted_when_the_engine_fails(server: Server, method: str) -> None:
    events = server.bus.subscribe(EVENTS.key("default"), 1000)
    server.client.spawn(a_culprit(method))
    if method == "set_base_state":
        server.client.set_entity_state("culprit", server.client.entity_state("culprit"))

    def is_frozen() -> bool:
        received = [decode(Event, one.payload, one.encoding) for one in events.take()]
        return any(one.entity == "culprit" and "SystemError" in one.message for one in received)

    if method != "discard":
        eventually(is_frozen, 10.0, "freezing")
    server.client.delete("culprit")
