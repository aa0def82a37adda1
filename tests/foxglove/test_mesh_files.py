"""Files of meshes, read by several threads at once."""

from concurrent.futures import ThreadPoolExecutor
from hashlib import sha256
from threading import Barrier
from typing import TYPE_CHECKING, Any, cast

import msgspec
import pytest

from zensim.foxglove.mesh_files import MeshFiles
from zensim.foxglove.scene_entities import MESH_URL
from zensim.proto.messages.asset_messages import GetAssetRequest, GetAssetResponse
from zensim.proto.service_catalog import GET_ASSET, Service

if TYPE_CHECKING:
    from zensim.proto.bus.bus_session import Bus

THREADS = 4
CONTENTS = [bytes([number]) * 100 for number in range(THREADS)]
FILES = {sha256(content).hexdigest(): content for content in CONTENTS}


class SlowBus:
    """A server whose replies to all threads come together."""

    def __init__(self, threads: int) -> None:
        self._barrier = Barrier(threads)

    def call(self, service: Service[Any, Any], request: msgspec.Struct, **_: object) -> Any:  # noqa: ANN401
        assert service is GET_ASSET
        assert isinstance(request, GetAssetRequest)
        self._barrier.wait(10.0)
        data = FILES[request.sha256]
        return GetAssetResponse(data=data, total=len(data))


def test_files_of_several_threads_are_all_returned_and_kept() -> None:
    files = MeshFiles(cast("Bus", SlowBus(THREADS)), "default")

    with ThreadPoolExecutor(THREADS) as pool:
        found = [*pool.map(lambda name: files.read(MESH_URL.format(name)), FILES)]

    assert found == CONTENTS
    # No call is made again: its barrier would wait for others.
    assert [files.read(MESH_URL.format(name)) for name in FILES] == CONTENTS


def test_file_that_is_removed_at_once_is_returned(monkeypatch: pytest.MonkeyPatch) -> None:
    files = MeshFiles(cast("Bus", SlowBus(1)), "default")
    name, content = next(iter(FILES.items()))

    def keep(_files: MeshFiles, _name: str, _content: bytes) -> None:
        """Keep nothing, as if another file had taken the place meanwhile."""

    monkeypatch.setattr(MeshFiles, "_keep", keep)

    assert files.read(MESH_URL.format(name)) == content
