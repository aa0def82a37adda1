"""Files of a scene that are fetched from a server that is slow, hangs, or lacks some."""

from hashlib import sha256
from typing import TYPE_CHECKING, cast

import pytest

from tests.fakes import ManualClock
from zensim.proto.bus.bus_errors import NoServer
from zensim.proto.messages.asset_messages import GetAssetRequest, GetAssetResponse
from zensim.sim_server.sensors.scene_roster import ASSET_TIMEOUT_S, FETCH_S, SceneMeshes

if TYPE_CHECKING:
    from zensim.proto.network_protocols import CallingNetwork

PART_BYTES = 100


class SlowServer:
    """Replies with a part of a file after a time."""

    def __init__(self, clock: ManualClock, files: dict[str, bytes], reply_s: float) -> None:
        self.reply_s = reply_s
        self.error: Exception | None = None
        self.offsets: list[int] = []
        self._clock = clock
        self._files = files

    def call(self, _: object, request: GetAssetRequest, **__: object) -> GetAssetResponse:
        self.offsets.append(request.offset)
        self._clock.sleep(self.reply_s)
        if self.error is not None:
            raise self.error
        data = self._files[request.sha256]
        return GetAssetResponse(data=data[request.offset :][:PART_BYTES], total=len(data))


def make_files(count: int, length: int) -> dict[str, bytes]:
    contents = [bytes([number]) * length for number in range(count)]
    return {sha256(content).hexdigest(): content for content in contents}


def make_meshes(server: SlowServer, clock: ManualClock) -> SceneMeshes:
    return SceneMeshes(cast("CallingNetwork", server), "default", clock)


def test_fetch_waits_once_for_a_server_that_hangs() -> None:
    clock, files = ManualClock(), make_files(20, 10)
    server = SlowServer(clock, files, ASSET_TIMEOUT_S)
    server.error = TimeoutError()

    found = make_meshes(server, clock).fetch_files(files)

    assert not found
    assert clock.now_s == ASSET_TIMEOUT_S


def test_long_files_are_fetched_in_several_turns_of_the_program() -> None:
    clock, files = ManualClock(), make_files(3, 10 * PART_BYTES)
    server = SlowServer(clock, files, 0.5)
    meshes, longest_s, fetches = make_meshes(server, clock), 0.0, 1

    began_s = clock.now_s
    while not meshes.fetch_files(files):
        longest_s = max(longest_s, clock.now_s - began_s)
        began_s, fetches = clock.now_s, fetches + 1

    assert longest_s <= FETCH_S + server.reply_s
    assert fetches > 3
    assert server.offsets == [PART_BYTES * part for part in range(10)] * 3


@pytest.mark.parametrize("error", [NoServer("away"), TimeoutError()])
def test_fetch_goes_on_after_a_failure(error: Exception) -> None:
    clock, files = ManualClock(), make_files(2, 2 * PART_BYTES)
    server = SlowServer(clock, files, 0.1)
    meshes = make_meshes(server, clock)
    server.error = error
    first = meshes.fetch_files(files)

    server.error = None
    second = meshes.fetch_files(files)

    assert (first, second) == (False, True)


def test_file_with_other_bytes_is_missing_and_the_others_are_there() -> None:
    clock, files = ManualClock(), make_files(2, 10)
    wrong, right = files
    files[wrong] = b"not the file of this name"
    meshes = make_meshes(SlowServer(clock, files, 0.1), clock)

    assert not meshes.fetch_files((wrong, right))
    assert meshes.fetch_files((right,))
