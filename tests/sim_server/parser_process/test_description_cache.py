"""Descriptions that the reader process reads: each once, for as long as its meshes are here."""

import time
from collections.abc import Iterator

import pytest

from tests.integration.processes import eventually
from tests.sim_server.description.meshes.test_mesh_conversion import BOX, exported
from tests.sim_server.fakes import WallTime
from tests.sim_server.parser_process.test_asset_store import put
from tests.sim_server.parser_process.test_parser_client import MESH_ROBOT
from zensim.proto.messages.asset_messages import AssetRef
from zensim.proto.messages.model_messages import Model
from zensim.proto.messages.spawn_messages import Resource, SpawnEntityOrder
from zensim.sim_server.errors import ModelError
from zensim.sim_server.parser_process.asset_store import AssetStore
from zensim.sim_server.parser_process.description_cache import MAX_MESHES_AT_ONCE, DescriptionCache
from zensim.sim_server.parser_process.parser_client import ParserClient

WITHIN_S = 30.0
STL = exported(BOX, "stl")
ROOMY, TIGHT = 3 * len(STL), len(STL)


class Reading:
    """A store of so many bytes, and the descriptions that are read with it."""

    def __init__(self, budget_bytes: int) -> None:
        self.wall = WallTime()
        self.parts_left = 0
        self.store = AssetStore(budget_bytes)
        self.reader = ParserClient(self.store, time.monotonic_ns)
        self.descriptions = DescriptionCache(
            self.reader, self.store, self.prepare, self.wall.now_ns
        )

    def prepare(self, _: Model) -> bool:
        """Take 5 ms for a part, as an engine may."""
        self.wall.sleep(0.005)
        self.parts_left -= 1
        return self.parts_left <= 0

    def order(self) -> SpawnEntityOrder:
        """Send the mesh, and ask for the robot that names it."""
        refs = (AssetRef("a.stl", put(self.store, STL)),)
        return SpawnEntityOrder(entity_resource=Resource(resource_string=MESH_ROBOT), assets=refs)

    def model(self, order: SpawnEntityOrder) -> Model:
        """Wait until a description is read."""

        def is_read() -> bool:
            self.descriptions.poll()
            return self.descriptions.is_parsed(order)

        eventually(is_read, WITHIN_S, "a model")
        return self.descriptions.model(order)[0]

    def close(self) -> None:
        """End the reader."""
        self.reader.close()
        self.store.close()


@pytest.fixture
def roomy() -> Iterator[Reading]:
    found = Reading(ROOMY)
    yield found
    found.close()


def fill(store: AssetStore) -> None:
    for number in range(3):
        put(store, bytes([number]) * len(STL))


def mesh_of(model: Model) -> str:
    return model.links[0].collisions[0].mesh


def test_description_is_read_once_for_all_that_ask(roomy: Reading) -> None:
    first = roomy.model(roomy.order())

    assert roomy.descriptions.is_parsed(roomy.order())
    assert roomy.model(roomy.order()) is first


def test_description_is_read_again_when_a_mesh_of_it_has_gone(roomy: Reading) -> None:
    mesh = mesh_of(roomy.model(roomy.order()))
    fill(roomy.store)
    assert mesh not in roomy.store

    again = roomy.model(roomy.order())

    assert mesh_of(again) == mesh
    assert mesh in roomy.store


def test_mesh_stays_while_its_description_is_asked_for(roomy: Reading) -> None:
    mesh = mesh_of(roomy.model(roomy.order()))

    for number in range(5):
        put(roomy.store, bytes([number]) * len(STL))
        roomy.model(roomy.order())

    assert mesh in roomy.store


def test_description_whose_meshes_have_no_room_is_refused() -> None:
    reading = Reading(TIGHT)

    with pytest.raises(ModelError, match=r"^mesh\.missing: "):
        reading.model(reading.order())

    reading.close()


def test_large_model_is_prepared_part_by_part_with_rests(roomy: Reading) -> None:
    roomy.parts_left = 3
    refs = (AssetRef("a.stl", put(roomy.store, STL)),)
    scene = MESH_ROBOT.replace("</robot>", "<gazebo><static>true</static></gazebo></robot>")
    order = SpawnEntityOrder(entity_resource=Resource(resource_string=scene), assets=refs)

    def is_begun() -> bool:
        roomy.descriptions.is_parsed(order)
        roomy.descriptions.poll()
        return roomy.parts_left == 2

    eventually(is_begun, WITHIN_S, "a first part")
    done = []
    for _ in range(30):
        roomy.wall.sleep(0.001)
        done.append(
            (roomy.descriptions.poll(), roomy.parts_left, roomy.descriptions.is_parsed(order))
        )

    assert done[8] == (False, 2, False)
    assert done[9] == (False, 1, False)
    assert done[18] == (False, 1, False)
    assert done[19] == (True, 0, True)


def test_corners_of_a_large_model_are_read_before_it_is_ready(
    roomy: Reading, monkeypatch: pytest.MonkeyPatch
) -> None:
    refs = (AssetRef("a.stl", put(roomy.store, STL)),)
    scene = MESH_ROBOT.replace("</robot>", "<gazebo><static>true</static></gazebo></robot>")
    order = SpawnEntityOrder(entity_resource=Resource(resource_string=scene), assets=refs)

    def is_read() -> bool:
        roomy.wall.sleep(1.0)
        roomy.descriptions.poll()
        return roomy.descriptions.is_parsed(order)

    eventually(is_read, WITHIN_S, "a model")

    with monkeypatch.context() as patch:
        patch.setattr(roomy.store, "read", None)
        assert len(roomy.store.vertices(mesh_of(roomy.descriptions.model(order)[0])))


def test_moving_model_of_many_collisions_is_prepared_though_they_are_one_mesh(
    roomy: Reading,
) -> None:
    roomy.parts_left = 1
    refs = (AssetRef("a.stl", put(roomy.store, STL)),)
    start, end = MESH_ROBOT.index("<collision>"), MESH_ROBOT.index("</collision>")
    end += len("</collision>")
    collision = MESH_ROBOT[start:end]
    text = MESH_ROBOT.replace(collision, collision * (MAX_MESHES_AT_ONCE + 1))
    order = SpawnEntityOrder(entity_resource=Resource(resource_string=text), assets=refs)

    def is_prepared() -> bool:
        roomy.wall.sleep(1.0)
        roomy.descriptions.poll()
        return roomy.descriptions.is_parsed(order)

    eventually(is_prepared, WITHIN_S, "a model")

    assert roomy.parts_left == 0


def test_small_model_needs_no_preparation(roomy: Reading) -> None:
    roomy.model(roomy.order())

    assert roomy.parts_left == 0


def test_description_that_another_server_read_is_not_read_again(roomy: Reading) -> None:
    order, other = (
        roomy.order(),
        DescriptionCache(roomy.reader, roomy.store, roomy.prepare, roomy.wall.now_ns),
    )
    model = roomy.model(order)
    reading = roomy.descriptions.find_parse_key(model)
    assert reading is not None

    other.remember(reading, model)

    assert other.is_parsed(order)
    assert other.model(order)[0] is model
    assert other.find_parse_key(model) == reading
    assert other.find_parse_key(Model("stranger", ())) is None
