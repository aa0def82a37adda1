"""DescriptionCache: each description is parsed once while its meshes are stored."""

import errno
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.integration.processes import eventually
from tests.sim_server.description.meshes.mesh_samples import BOX, exported
from tests.sim_server.fakes import WallTime
from tests.sim_server.parser_process.test_asset_store import put
from tests.sim_server.parser_process.test_parser_client import MESH_ROBOT
from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.sim_server.errors import ModelError
from zensim.sim_server.parser_process.asset_store import AssetFolder, AssetStore
from zensim.sim_server.parser_process.description_cache import MAX_MESHES_AT_ONCE, DescriptionCache
from zensim.sim_server.parser_process.parser_client import ParserClient

WITHIN_S = 30.0
STL = exported(BOX, "stl")
LARGE_BYTES, SMALL_BYTES = 3 * len(STL), len(STL)


class ParserFixture:
    """A parser, a store of limited size, and the cache of descriptions."""

    def __init__(self, budget_bytes: int) -> None:
        self.wall = WallTime()
        self.parts_left = 0
        self.store = AssetStore(budget_bytes)
        self.parser = ParserClient(self.store, time.monotonic_ns)
        self.descriptions = DescriptionCache(
            self.parser, self.store, self.prepare, self.wall.now_ns
        )

    def prepare(self, _: Model) -> bool:
        """Spend 5 ms on a part."""
        self.wall.sleep(0.005)
        self.parts_left -= 1
        return self.parts_left <= 0

    def order(self) -> SpawnEntityOrder:
        """Upload the mesh and make the order of a robot with it."""
        refs = (AssetRef("a.stl", put(self.store, STL)),)
        return SpawnEntityOrder(entity_resource=Resource(resource_string=MESH_ROBOT), assets=refs)

    def model(self, order: SpawnEntityOrder) -> Model:
        """Wait until a description is parsed."""

        def is_parsed() -> bool:
            self.descriptions.poll()
            return self.descriptions.is_parsed(order)

        eventually(is_parsed, WITHIN_S, "a model")
        return self.descriptions.model(order)[0]

    def close(self) -> None:
        """End the parser and remove the store."""
        self.parser.close()
        self.store.close()


@pytest.fixture
def fixture() -> Iterator[ParserFixture]:
    made = ParserFixture(LARGE_BYTES)
    yield made
    made.close()


def fill(store: AssetStore) -> None:
    for number in range(3):
        put(store, bytes([number]) * len(STL))


def mesh_of(model: Model) -> str:
    return model.links[0].collisions[0].mesh


def test_description_is_parsed_once_for_equal_orders(fixture: ParserFixture) -> None:
    first = fixture.model(fixture.order())

    assert fixture.descriptions.is_parsed(fixture.order())
    assert fixture.model(fixture.order()) is first


def test_description_is_parsed_again_when_its_mesh_was_evicted(fixture: ParserFixture) -> None:
    mesh = mesh_of(fixture.model(fixture.order()))
    fill(fixture.store)
    assert mesh not in fixture.store

    parsed_again = fixture.model(fixture.order())

    assert mesh_of(parsed_again) == mesh
    assert mesh in fixture.store


def test_mesh_is_not_evicted_while_its_description_is_used(fixture: ParserFixture) -> None:
    mesh = mesh_of(fixture.model(fixture.order()))

    for number in range(5):
        put(fixture.store, bytes([number]) * len(STL))
        fixture.model(fixture.order())

    assert mesh in fixture.store


def test_description_is_refused_when_its_meshes_do_not_fit() -> None:
    fixture = ParserFixture(SMALL_BYTES)

    with pytest.raises(ModelError) as refused:
        fixture.model(fixture.order())

    assert refused.value.slug == "mesh.missing"
    fixture.close()


def test_large_model_is_prepared_in_parts_with_pauses(fixture: ParserFixture) -> None:
    fixture.parts_left = 3
    refs = (AssetRef("a.stl", put(fixture.store, STL)),)
    scene = MESH_ROBOT.replace("</robot>", "<gazebo><static>true</static></gazebo></robot>")
    order = SpawnEntityOrder(entity_resource=Resource(resource_string=scene), assets=refs)

    def is_begun() -> bool:
        fixture.descriptions.is_parsed(order)
        fixture.descriptions.poll()
        return fixture.parts_left == 2

    eventually(is_begun, WITHIN_S, "a first part")
    done = []
    for _ in range(30):
        fixture.wall.sleep(0.001)
        done.append(
            (fixture.descriptions.poll(), fixture.parts_left, fixture.descriptions.is_parsed(order))
        )

    assert done[8] == (False, 2, False)
    assert done[9] == (False, 1, False)
    assert done[18] == (False, 1, False)
    assert done[19] == (True, 0, True)


def test_vertices_of_a_large_model_are_read_before_it_is_ready(
    fixture: ParserFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    refs = (AssetRef("a.stl", put(fixture.store, STL)),)
    scene = MESH_ROBOT.replace("</robot>", "<gazebo><static>true</static></gazebo></robot>")
    order = SpawnEntityOrder(entity_resource=Resource(resource_string=scene), assets=refs)

    def is_parsed() -> bool:
        fixture.wall.sleep(1.0)
        fixture.descriptions.poll()
        return fixture.descriptions.is_parsed(order)

    eventually(is_parsed, WITHIN_S, "a model")

    with monkeypatch.context() as patch:
        patch.setattr(fixture.store, "read", None)
        assert len(fixture.store.vertices(mesh_of(fixture.descriptions.model(order)[0])))


def test_moving_model_with_many_collisions_of_one_mesh_is_prepared(fixture: ParserFixture) -> None:
    fixture.parts_left = 1
    refs = (AssetRef("a.stl", put(fixture.store, STL)),)
    start, end = MESH_ROBOT.index("<collision>"), MESH_ROBOT.index("</collision>")
    end += len("</collision>")
    collision = MESH_ROBOT[start:end]
    text = MESH_ROBOT.replace(collision, collision * (MAX_MESHES_AT_ONCE + 1))
    order = SpawnEntityOrder(entity_resource=Resource(resource_string=text), assets=refs)

    def is_prepared() -> bool:
        fixture.wall.sleep(1.0)
        fixture.descriptions.poll()
        return fixture.descriptions.is_parsed(order)

    eventually(is_prepared, WITHIN_S, "a model")

    assert fixture.parts_left == 0


def test_small_model_needs_no_preparation(fixture: ParserFixture) -> None:
    fixture.model(fixture.order())

    assert fixture.parts_left == 0


def test_description_parsed_by_another_server_is_not_parsed_again(fixture: ParserFixture) -> None:
    order, other = (
        fixture.order(),
        DescriptionCache(fixture.parser, fixture.store, fixture.prepare, fixture.wall.now_ns),
    )
    model = fixture.model(order)
    key = fixture.descriptions.find_parse_key(model)
    assert key is not None

    other.remember(key, model)

    assert other.is_parsed(order)
    assert other.model(order)[0] is model
    assert other.find_parse_key(model) == key
    assert other.find_parse_key(Model("other", ())) is None


def test_description_is_refused_when_its_meshes_cannot_be_written_and_parsed_later(
    fixture: ParserFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    order = fixture.order()
    with monkeypatch.context() as full:
        full.setattr(AssetFolder, "write", fail)
        with pytest.raises(ModelError) as refused:
            fixture.model(order)

    assert refused.value.slug == "bundle.disk"
    fixture.descriptions.poll()
    assert mesh_of(fixture.model(order)) in fixture.store


def test_description_is_refused_when_its_files_are_gone_and_parsed_later(
    fixture: ParserFixture,
) -> None:
    order = fixture.order()
    Path(fixture.store.folder, f"{order.assets[0].sha256}.stl").unlink()

    with pytest.raises(ModelError) as refused:
        fixture.model(order)

    assert refused.value.slug in ("bundle.disk", "mesh.missing")
    fixture.descriptions.poll()
    assert mesh_of(fixture.model(fixture.order())) in fixture.store
