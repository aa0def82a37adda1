"""Meshes are fetched once each, in pieces; what cannot be had holds nothing up."""

from hashlib import sha256

import msgspec
import numpy as np
import pytest

from tests.fakes import ManualClock
from zensim.proto.bus import NoServer
from zensim.proto.messages.asset_messages import GetAssetRequest, GetAssetResponse
from zensim.proto.messages.model_messages import Link, Model, Shape
from zensim.proto.messages.result_messages import ServiceError
from zensim.proto.service_catalog import Request, Response, Service
from zensim.proto.stl import write_corners
from zensim.spawner.page.data_source import MESH_BUDGET_BYTES, MESH_RETRY_S, MeshFetcher


def a_mesh(size: float = 1.0) -> bytes:
    corners = [[0.0, 0.0, 0.0], [size, 0.0, 0.0], [0.0, size, 0.0]]
    return write_corners(np.array([corners, corners[::-1]]))


class Store:
    """A server that has these files, and sends so many bytes at once."""

    def __init__(self, *files: bytes, piece: int = 1 << 20) -> None:
        self.files = {sha256(data).hexdigest(): data for data in files}
        self.piece = piece
        self.asked: list[tuple[str, int]] = []
        self.fault: Exception | None = None

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
        self.asked.append((request.sha256, request.offset))
        if self.fault is not None:
            raise self.fault
        if (data := self.files.get(request.sha256)) is None:
            raise ServiceError(service.name, 2, "NOT_FOUND", "no such file")
        part = data[request.offset : request.offset + self.piece]
        return msgspec.convert(GetAssetResponse(data=part, total=len(data)), service.response)


class Stand:
    """A fetcher between a store and a clock."""

    def __init__(self, store: Store, *named: bytes, budget_bytes: int = MESH_BUDGET_BYTES) -> None:
        self.clock = ManualClock()
        self.fetcher = MeshFetcher(store, "w", self.clock, budget_bytes)
        self.names = [sha256(data).hexdigest() for data in named]
        self.want(*self.names)

    def want(self, *names: str) -> None:
        visuals = tuple(Shape("mesh", (1.0, 1.0, 1.0), mesh=name) for name in names)
        self.fetcher.want([Model("m", (Link("base", visuals=visuals),))])

    def fetch(self, times: int = 10) -> list[str]:
        for _ in range(times):
            self.fetcher.fetch()
        return list(self.fetcher.meshes)


def test_mesh_is_fetched_piece_by_piece_and_once() -> None:
    data = a_mesh()
    store = Store(data, piece=100)
    stand = Stand(store, data, data)

    found = stand.fetch()

    assert found == [sha256(data).hexdigest()]
    assert [offset for _, offset in store.asked] == [0, 100]
    assert len(stand.fetcher.meshes[found[0]].vertices) == 3


def test_meshes_are_shown_when_all_that_can_be_had_have_come() -> None:
    here, gone = a_mesh(1.0), a_mesh(2.0)
    stand = Stand(Store(here), here, gone)

    assert stand.fetch(1) == []
    assert stand.fetch(1) == stand.names[:1]


def test_mesh_that_was_not_there_is_asked_for_again_with_the_next_models() -> None:
    data = a_mesh()
    store = Store()
    stand = Stand(store, data)
    assert stand.fetch() == []

    store.files[stand.names[0]] = data
    stand.want(*stand.names)

    assert stand.fetch() == stand.names
    assert len(store.asked) == 2


def test_mesh_is_asked_for_again_after_a_while_when_nobody_answers() -> None:
    data = a_mesh()
    store = Store(data)
    store.fault = NoServer("nobody")
    stand = Stand(store, data)
    stand.clock.sleep(1.0)
    stand.fetch()
    store.fault = None

    assert (stand.fetch(), len(store.asked)) == ([], 1)
    stand.clock.sleep(MESH_RETRY_S)
    assert stand.fetch() == stand.names


def test_mesh_that_nobody_names_is_forgotten() -> None:
    data = a_mesh()
    stand = Stand(Store(data), data)
    stand.fetch()

    stand.want()

    assert stand.fetch() == []


@pytest.mark.parametrize(
    "bad", [b"no mesh", write_corners(np.full((1, 3, 3), np.nan)), a_mesh()[:84]]
)
def test_bytes_that_are_no_mesh_are_not_drawn(bad: bytes) -> None:
    good = a_mesh()

    assert Stand(Store(bad, good), bad, good).fetch() == [sha256(good).hexdigest()]


def test_bytes_of_another_name_are_not_drawn() -> None:
    data = a_mesh()
    store = Store()
    store.files[sha256(b"asked for").hexdigest()] = data

    assert Stand(store, b"asked for").fetch() == []


def test_meshes_beyond_the_budget_are_left_out() -> None:
    first, second = a_mesh(1.0), a_mesh(2.0)
    stand = Stand(Store(first, second), first, second, budget_bytes=len(first) + 1)

    assert stand.fetch() == stand.names[:1]
