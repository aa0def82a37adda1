"""Data source of the viewer: snapshots, models, commands and meshes."""

from hashlib import sha256
from typing import Final

import msgspec
import numpy as np
import pytest

from tests.fakes import ManualClock, MemoryBus
from tests.spawner.page.builders import (
    FakeServer,
    make_models,
    make_robot,
    make_snapshot,
    make_wall,
)
from zensim.proto import keys, topic_catalog
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.asset_messages import GetAssetRequest, GetAssetResponse
from zensim.proto.messages.model_messages import Link, Model, Shape, Texture
from zensim.proto.messages.result_messages import Result, ResultCode, ServiceError
from zensim.proto.messages.standard_messages import Twist, TwistStamped, Vector3
from zensim.proto.messages.telemetry_messages import GetModelsRequest, GetModelsResponse
from zensim.proto.messages.world_messages import Scene
from zensim.proto.service_catalog import Request, Response, Service
from zensim.proto.stl import write_corners
from zensim.spawner.client.world_follower import PERIOD_S
from zensim.spawner.page.mesh_fetcher import (
    FETCH_BUDGET_S,
    MESH_BUDGET_BYTES,
    MESH_RETRY_S,
    MeshFetcher,
)
from zensim.spawner.page.render_state import LastCommand
from zensim.spawner.page.viewer_data import (
    MIN_FRAME_PERIOD_S,
    SERVER_TIMEOUT_S,
    STILL_PERIOD_S,
    ViewerDataSource,
    ViewState,
)

SNAPSHOT: Final = topic_catalog.SNAPSHOT.key("default")
NO_ENTITIES: Final[frozenset[str]] = frozenset()


class Setup:
    """A data source and its server."""

    def __init__(self) -> None:
        self.bus = MemoryBus()
        self.clock = ManualClock()
        self.server = FakeServer(self.bus, make_models(r1=make_robot("r1"), r2=make_robot("r2")))
        self.token = self.bus.token(keys.alive_server("default"))
        fetcher = MeshFetcher(self.bus, "default", self.clock)
        self.source = ViewerDataSource(self.bus, "default", self.clock, fetcher)

    def receive(self, *names: str, roster: int = 1, at_x: float = 0.0) -> ViewState | None:
        """Publish a snapshot 1 s later, and return the view."""
        self.clock.sleep(1.0)
        joints = sum(name.startswith("r") for name in names)
        self.server.publish(make_snapshot(*names, roster=roster, joints=joints, at_x=at_x))
        return self.source.newest()


def test_snapshot_is_returned_with_its_status() -> None:
    setup = Setup()

    view = setup.receive("r1", "r2", at_x=5.0)

    assert view is not None
    assert view.frame.base[:, 0].tolist() == [5.0, 6.0]
    assert (view.status.state, view.status.sim_time_s, view.status.robots) == ("playing", 1.0, 2)


def test_nothing_is_returned_without_a_snapshot() -> None:
    assert Setup().source.newest() is None


def test_models_are_requested_once_per_roster() -> None:
    setup = Setup()

    first, second = setup.receive("r1", "r2"), setup.receive("r1", "r2")

    assert first is not None
    assert second is not None
    assert first.fleet is second.fleet
    assert setup.server.count(GetModelsRequest) == 1


def test_frame_is_the_same_object_until_something_moves() -> None:
    setup = Setup()

    views = [setup.receive("r1", "r2", at_x=at_x) for at_x in (1.0, 1.0, 2.0)]

    first, second, third = (view.frame for view in views if view is not None)
    assert first is second
    assert second is not third


def receive_soon(
    setup: Setup, *, is_still_shown: bool = False, at_x: float = 0.0, state: str = "playing"
) -> bool:
    """Publish a snapshot a frame later; return whether it is shown."""
    setup.clock.sleep(1.5 * MIN_FRAME_PERIOD_S)
    setup.server.publish(make_snapshot("r1", joints=1, at_x=at_x, state=state))
    return setup.source.newest(is_still_shown=is_still_shown) is not None


def test_a_world_in_which_nothing_moves_is_shown_less_often() -> None:
    setup = Setup()
    setup.receive("r1")

    shown = [receive_soon(setup) for _ in range(20)]

    passed_s = 20 * 1.5 * MIN_FRAME_PERIOD_S
    assert 1 < sum(shown) <= passed_s / STILL_PERIOD_S
    assert all(receive_soon(setup, is_still_shown=True) for _ in range(5))


def test_what_moves_or_another_state_is_shown_at_once() -> None:
    setup = Setup()
    setup.receive("r1")
    assert not receive_soon(setup)

    assert receive_soon(setup, at_x=1.0)
    assert not receive_soon(setup, at_x=1.0)
    assert receive_soon(setup, at_x=1.0, state="paused")
    assert receive_soon(setup, at_x=1.0, state="paused")  # a step, for its time


def test_models_are_requested_again_when_the_roster_changes() -> None:
    setup = Setup()
    setup.receive("r1", "r2")
    setup.server.models = make_models(2, r1=make_robot(), r2=make_robot(), w1=make_wall())

    view = setup.receive("r1", "r2", "w1", roster=2)

    assert view is not None
    assert (view.status.robots, view.status.entities) == (2, 3)


def test_model_is_replaced_when_a_name_is_reused() -> None:
    setup = Setup()
    setup.receive("r1", "r2")
    setup.server.models = make_models(2, r1=make_robot(), r2=make_wall())

    setup.clock.sleep(1.0)
    setup.server.publish(make_snapshot("r1", "r2", roster=2, joints=1))
    view = setup.source.newest()

    assert view is not None
    assert view.fleet.robots == ("r1",)


def test_nothing_is_returned_for_an_unknown_entity() -> None:
    setup = Setup()

    assert setup.receive("r1", "r2", "r3", roster=2) is None


def test_meshes_are_used_once_fetched() -> None:
    setup = Setup()
    data = write_corners(np.array([[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]]))
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh=sha256(data).hexdigest())
    setup.server.models = make_models(r1=make_robot("r1", shape=shape))
    setup.server.responses["get_asset"] = GetAssetResponse(data=data, total=len(data))

    first, second = setup.receive("r1"), setup.receive("r1")

    assert first is not None
    assert second is not None
    assert first.fleet.templates["r1"].links[0] == ()
    assert second.fleet.templates["r1"].links[0] == (shape,)
    assert list(second.fleet.meshes) == [shape.mesh]


def test_no_mesh_is_requested_without_a_server() -> None:
    setup = Setup()
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh="a" * 64)
    setup.server.models = make_models(r1=make_robot("r1", shape=shape))
    setup.receive("r1")

    setup.token.close()
    setup.clock.sleep(1.0)
    setup.source.newest()

    assert setup.server.count(GetAssetRequest) == 0


def test_scene_is_returned() -> None:
    setup = Setup()
    scene = Scene(background=(0.0, 0.0, 1.0, 1.0))
    setup.server.models = msgspec.structs.replace(setup.server.models, scene=scene)

    view = setup.receive("r1", "r2")

    assert view is not None
    assert view.fleet.scene == scene


def test_models_are_requested_at_a_limited_rate() -> None:
    setup = Setup()
    setup.receive("r1", "r3", roster=7)
    count = setup.server.count(GetModelsRequest)

    setup.clock.sleep(PERIOD_S / 2.0)
    setup.server.publish(make_snapshot("r1", "r3", roster=8, joints=2))
    setup.source.newest()

    assert setup.server.count(GetModelsRequest) == count


@pytest.mark.parametrize("payload", [b"", b"\x00", b"\xff\xff", b"{}", b"\x81\xa1a\x01"])
def test_malformed_snapshot_is_ignored(payload: bytes) -> None:
    setup = Setup()
    setup.receive("r1", "r2")

    setup.clock.sleep(1.0)
    setup.bus.put(SNAPSHOT, payload)

    assert setup.source.newest() is None
    assert setup.receive("r1", "r2") is not None


def test_frame_rate_is_limited() -> None:
    setup = Setup()
    setup.receive("r1", "r2")

    setup.clock.sleep(MIN_FRAME_PERIOD_S / 2.0)
    setup.server.publish(make_snapshot("r1", "r2", joints=2, at_x=1.0))
    too_early = setup.source.newest()
    setup.clock.sleep(MIN_FRAME_PERIOD_S)

    assert too_early is None
    assert setup.source.newest() is not None


def test_refused_models_set_an_error_text() -> None:
    setup = Setup()
    refusal = Result(ResultCode.OPERATION_FAILED, "refused")
    setup.server.responses["get_models"] = GetModelsResponse(refusal)

    assert setup.receive("r1", "r2") is None
    assert "refused" in setup.source.error_text


def test_error_text_is_cleared_by_models() -> None:
    setup = Setup()
    setup.server.is_silent = True
    setup.receive("r1", "r2")
    error_text = setup.source.error_text
    setup.server.is_silent = False

    assert setup.receive("r1", "r2") is not None
    assert error_text
    assert setup.source.error_text == ""


def test_source_is_silent_when_the_token_disappears() -> None:
    setup = Setup()
    setup.receive("r1", "r2")

    setup.token.close()
    setup.source.newest()

    assert setup.source.is_silent


def test_source_is_silent_without_snapshots() -> None:
    setup = Setup()
    setup.receive("r1", "r2")

    setup.clock.sleep(SERVER_TIMEOUT_S + 0.1)

    assert setup.source.newest() is None
    assert setup.source.is_silent


def test_models_are_requested_again_from_a_new_server() -> None:
    setup = Setup()
    setup.receive("r1", "r2")
    setup.token.close()
    setup.server.models = make_models(r1=make_wall(), r2=make_robot())
    setup.bus.token(keys.alive_server("default"))

    setup.clock.sleep(1.0)
    setup.server.publish(make_snapshot("r1", "r2", joints=1))
    view = setup.source.newest()

    assert view is not None
    assert view.fleet.robots == ("r2",)
    assert not setup.source.is_silent


def test_only_commands_of_followed_robots_are_subscribed() -> None:
    setup = Setup()
    setup.receive("r1", "r2")

    setup.source.commands(frozenset({"r1", "gone"}))

    assert setup.bus.has_subscriber("r1/cmd_vel")
    assert not setup.bus.has_subscriber("r2/cmd_vel")
    setup.source.commands(NO_ENTITIES)
    assert not setup.bus.has_subscriber("r1/cmd_vel")


def test_clicked_wall_without_a_namespace_has_no_commands() -> None:
    setup = Setup()
    models = make_models(r1=make_robot(), wall=make_wall())
    wall = msgspec.structs.replace(models.entities[1], namespace="")
    setup.server.models = msgspec.structs.replace(models, entities=(models.entities[0], wall))
    setup.receive("r1", "wall")

    assert setup.source.commands(frozenset({"wall"})) == {}

    assert not setup.bus.has_subscriber("/cmd_vel")


@pytest.mark.parametrize("is_stamped", [False, True])
def test_last_command_is_returned_with_its_age(*, is_stamped: bool) -> None:
    setup = Setup()
    setup.receive("r1", "r2")
    setup.source.commands(frozenset({"r1"}))
    twist = Twist(Vector3(x=0.2), Vector3(z=-0.5))

    setup.bus.put_message("r1/cmd_vel", TwistStamped(twist=twist) if is_stamped else twist)
    setup.source.commands(frozenset({"r1"}))
    setup.clock.sleep(2.0)

    commands = setup.source.commands(frozenset({"r1"}))

    assert commands == {"r1": LastCommand(0.2, -0.5, age_s=2.0)}


def test_malformed_command_is_ignored() -> None:
    setup = Setup()
    setup.receive("r1", "r2")
    setup.source.commands(frozenset({"r1"}))
    setup.bus.put_message("r1/cmd_vel", Twist(Vector3(x=0.2)))
    setup.source.commands(frozenset({"r1"}))

    setup.bus.put("r1/cmd_vel", b"\x07garbage")

    assert setup.source.commands(frozenset({"r1"}))["r1"].forward_mps == 0.2


def test_no_command_is_returned_without_one() -> None:
    setup = Setup()
    setup.receive("r1", "r2")

    assert setup.source.commands(frozenset({"r1"})) == {}


def test_close_ends_all_subscriptions() -> None:
    setup = Setup()
    setup.receive("r1", "r2")
    setup.source.commands(frozenset({"r1"}))

    setup.source.close()

    assert not setup.bus.has_subscriber("**")


def make_mesh(size: float = 1.0) -> bytes:
    corners = [[0.0, 0.0, 0.0], [size, 0.0, 0.0], [0.0, size, 0.0]]
    return write_corners(np.array([corners, corners[::-1]]))


class FileServer:
    """Serves files in chunks."""

    def __init__(self, *files: bytes, chunk: int = 1 << 20) -> None:
        self.files = {sha256(data).hexdigest(): data for data in files}
        self.chunk = chunk
        self.requests: list[tuple[str, int]] = []
        self.error: Exception | None = None
        self.clock = ManualClock()
        """Advances at each call, so that each `fetch` makes one."""

    def call(
        self,
        service: Service[Request, Response],
        request: Request,
        *,
        world: str,
        timeout_s: float = 5.0,
        request_id: str = "",
    ) -> Response:
        del request_id
        assert isinstance(request, GetAssetRequest)
        assert (world, timeout_s < 1.0) == ("w", True)
        self.clock.sleep(FETCH_BUDGET_S)
        self.requests.append((request.sha256, request.offset))
        if self.error is not None:
            raise self.error
        if (data := self.files.get(request.sha256)) is None:
            raise ServiceError(service.name, 2, "NOT_FOUND", "no such file")
        part = data[request.offset : request.offset + self.chunk]
        return msgspec.convert(GetAssetResponse(data=part, total=len(data)), service.response)


class FetcherSetup:
    """A fetcher, its server and a clock."""

    def __init__(
        self, server: FileServer, *named: bytes, budget_bytes: int = MESH_BUDGET_BYTES
    ) -> None:
        self.clock = server.clock
        self.fetcher = MeshFetcher(server, "w", self.clock, budget_bytes)
        self.names = [sha256(data).hexdigest() for data in named]
        self.set_meshes(*self.names)

    def set_meshes(self, *names: str) -> None:
        visuals = tuple(Shape("mesh", (1.0, 1.0, 1.0), mesh=name) for name in names)
        self.fetcher.set_models([Model("m", (Link("base", visuals=visuals),))])

    def fetch(self, times: int = 20) -> list[str]:
        for _ in range(times):
            self.fetcher.fetch()
        return list(self.fetcher.meshes)


def test_mesh_is_fetched_once_in_chunks() -> None:
    data = make_mesh()
    server = FileServer(data, chunk=100)
    setup = FetcherSetup(server, data, data)

    found = setup.fetch()

    assert found == [sha256(data).hexdigest()]
    assert [offset for _, offset in server.requests] == [0, 100]
    assert len(setup.fetcher.meshes[found[0]].vertices) == 3


def test_meshes_are_published_when_all_are_fetched() -> None:
    here, gone = make_mesh(1.0), make_mesh(2.0)
    setup = FetcherSetup(FileServer(here), here, gone)

    assert setup.fetch(1) == []
    assert setup.fetch(1) == setup.names[:1]


def test_meshes_of_collisions_follow_those_of_visuals() -> None:
    files, names = (make_mesh(1.0), make_mesh(2.0)), []
    setup = FetcherSetup(FileServer(*files), *files)
    visual, collision = (Shape("mesh", (1.0, 1.0, 1.0), mesh=name) for name in setup.names)
    links = (Link("base", visuals=(visual,), collisions=(collision,)),)

    setup.fetcher.set_models([Model("bot", links)])
    for _ in range(4):
        setup.fetcher.fetch()
        names.append([*setup.fetcher.meshes])

    assert [visual.mesh] in names
    assert set(names[-1]) == {visual.mesh, collision.mesh}


def test_missing_mesh_is_requested_again_with_new_models() -> None:
    data = make_mesh()
    server = FileServer()
    setup = FetcherSetup(server, data)
    assert setup.fetch() == []

    server.files[setup.names[0]] = data
    setup.set_meshes(*setup.names)

    assert setup.fetch() == setup.names
    assert len(server.requests) == 2


def test_mesh_is_requested_again_after_no_reply() -> None:
    data = make_mesh()
    server = FileServer(data)
    server.error = NoServer("no server")
    setup = FetcherSetup(server, data)
    setup.clock.sleep(1.0)
    setup.fetch()
    server.error = None

    assert (setup.fetch(), len(server.requests)) == ([], 1)
    setup.clock.sleep(MESH_RETRY_S)
    assert setup.fetch() == setup.names


IMAGE = b"\x89PNG\r\n\x1a\n and more"
COORDINATES = np.arange(12.0).astype("<f4").tobytes()


def show_textured(*files: bytes, image: bytes = IMAGE, points: bytes = COORDINATES) -> MeshFetcher:
    """Fetch a mesh of two triangles with a texture."""
    setup = FetcherSetup(FileServer(make_mesh(), *files))
    mesh, picture, places = (sha256(data).hexdigest() for data in (make_mesh(), image, points))
    shape = Shape("mesh", (1.0, 1.0, 1.0), mesh=mesh, texture=Texture(picture, places))
    setup.fetcher.set_models([Model("m", (Link("base", visuals=(shape,)),))])
    setup.fetch()
    return setup.fetcher


def test_textured_mesh_is_fetched_with_image_and_coordinates() -> None:
    (mesh,) = show_textured(IMAGE, COORDINATES).meshes.values()

    assert mesh.image == IMAGE
    assert mesh.coordinates is not None
    assert mesh.coordinates.ravel().tolist() == list(range(12))
    assert mesh.vertices.shape == (6, 3)


@pytest.mark.parametrize(
    ("files", "image", "points"),
    [
        ((COORDINATES,), IMAGE, COORDINATES),
        ((IMAGE,), IMAGE, COORDINATES),
        ((IMAGE, COORDINATES[:-8]), IMAGE, COORDINATES[:-8]),
        ((b"<svg/>", COORDINATES), b"<svg/>", COORDINATES),
        ((IMAGE, b"\xff" * 48), IMAGE, b"\xff" * 48),
    ],
    ids=["no_image", "no_points", "few_points", "other_image", "nan"],
)
def test_mesh_without_a_usable_texture_is_plain(
    files: tuple[bytes, ...], image: bytes, points: bytes
) -> None:
    fetcher = show_textured(*files, image=image, points=points)

    assert [*fetcher.meshes] == [sha256(make_mesh()).hexdigest()]


def test_unused_mesh_is_dropped() -> None:
    data = make_mesh()
    setup = FetcherSetup(FileServer(data), data)
    setup.fetch()

    setup.set_meshes()

    assert setup.fetch() == []


@pytest.mark.parametrize(
    "bad", [b"not a mesh", write_corners(np.full((1, 3, 3), np.nan)), make_mesh()[:84]]
)
def test_malformed_mesh_is_skipped(bad: bytes) -> None:
    good = make_mesh()

    assert FetcherSetup(FileServer(bad, good), bad, good).fetch() == [sha256(good).hexdigest()]


def test_mesh_with_another_hash_is_skipped() -> None:
    data = make_mesh()
    server = FileServer()
    server.files[sha256(b"requested").hexdigest()] = data

    assert FetcherSetup(server, b"requested").fetch() == []


def test_meshes_beyond_the_budget_are_skipped() -> None:
    first, second = make_mesh(1.0), make_mesh(2.0)
    setup = FetcherSetup(FileServer(first, second), first, second, budget_bytes=len(first) + 1)

    assert setup.fetch() == setup.names[:1]
